import re

import numpy as np
import pytest

from solver.design.d_optimal import choose_poses
from solver.design.stop_rule import PrecisionStatus, standard_deviations, stop_decision


@pytest.fixture(scope="module")
def chosen(told):
    return choose_poses(told.root, 12)


def requests(told, chosen, factor: float) -> dict[str, float]:
    sigma = standard_deviations(told.of(chosen))
    return dict(zip(told.parameters, factor * sigma, strict=True))


def test_reached(told, chosen):
    decision = stop_decision(told.of(chosen), told, requests(told, chosen, 1.01), poses_left=5)
    assert decision.standing is PrecisionStatus.REACHED
    assert decision.stop
    assert decision.text.endswith("as requested, for errors of stated size")


def test_going_on_names_the_weakest_and_the_forecast_is_enough(told, chosen):
    goal = requests(told, chosen, 0.8)
    goal["s_1"] *= 0.7
    decision = stop_decision(told.of(chosen), told, goal, poses_left=60)
    assert decision.standing is PrecisionStatus.GOING_ON
    assert decision.weak[0].name == "s_1"
    assert 3 < int(re.search(r"about (\d+) more poses", decision.text)[1]) < 60
    assert not decision.stop


def test_a_request_out_of_reach_goes_on_while_poses_help(told, chosen):
    goal = {"alpha_0": 1e-9, "theta_off_1": 1.0}
    decision = stop_decision(told.of(chosen), told, goal, poses_left=10)
    assert decision.standing is PrecisionStatus.GOING_ON
    assert [w.name for w in decision.weak] == ["alpha_0"]
    assert "10 more poses would not bring alpha_0" in decision.text
    assert decision.weak[0].forecast < decision.weak[0].sigma


def test_hopeless_when_no_pose_helps_any_more(told, chosen):
    goal = {"alpha_0": 1e-9, "theta_off_1": 1.0}
    # After 1,200 poses ten more are nothing.
    decision = stop_decision(told.of(list(chosen) * 100), told, goal, poses_left=10)
    assert decision.standing is PrecisionStatus.HOPELESS
    assert decision.stop
    assert [w.name for w in decision.weak] == ["alpha_0"]


def test_no_pose_left_says_what_stays_weak(told, chosen):
    decision = stop_decision(told.of(chosen), told, {"alpha_0": 1e-9}, poses_left=0)
    assert decision.standing is PrecisionStatus.HOPELESS
    assert decision.text.startswith("alpha_0 not known as well as requested")


def test_forecast_is_never_better_than_all_poses_could_be(told, chosen):
    goal = requests(told, chosen, 0.5)
    decision = stop_decision(told.of(chosen), told, goal, poses_left=4)
    root = told.root
    # Four more poses cannot beat four times the whole region's information.
    everything = told.of(chosen) + 4.0 * np.einsum("mrp,mrq->pq", root, root)
    bound = dict(zip(told.parameters, standard_deviations(everything), strict=True))
    assert all(w.forecast >= bound[w.name] for w in decision.weak)


def test_too_few_poses_leave_parameters_open(told):
    sigma = standard_deviations(told.of([0, 1]))
    assert np.isinf(sigma).any()
    decision = stop_decision(
        told.of([0, 1]), told, dict.fromkeys(told.parameters, 1.0), poses_left=20
    )
    assert decision.standing is PrecisionStatus.GOING_ON


def test_unknown_name_is_a_wrong_call(told, chosen):
    with pytest.raises(ValueError, match="a_9"):
        stop_decision(told.of(chosen), told, {"a_9": 1.0}, poses_left=1)

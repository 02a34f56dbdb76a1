import re

import numpy as np
import pytest

from solver.design import stop_rule
from solver.design.stop_rule import standard_deviations
from tests.solver.design.conftest import choose_poses


@pytest.fixture(scope="module")
def chosen(pose_data):
    return choose_poses(pose_data.root, 12)


def sigmas(information):
    """Standard deviations of all unknowns, none of which are effects."""
    return standard_deviations(information, len(information))


def stop_decision(information, candidates, requested, *, poses_left):
    """The decision if every candidate can be reached."""
    allowed = np.ones(len(candidates.root), dtype=bool)
    return stop_rule.stop_decision(
        information, candidates, requested, poses_left=poses_left, allowed=allowed
    )


def requests(pose_data, chosen, factor: float) -> dict[str, float]:
    return dict(zip(pose_data.parameters, factor * sigmas(pose_data.of(chosen)), strict=True))


def test_stops_when_the_requested_sigmas_are_reached(pose_data, chosen):
    decision = stop_decision(
        pose_data.of(chosen), pose_data, requests(pose_data, chosen, 1.01), poses_left=5
    )
    assert decision.stop
    assert not decision.weak
    assert decision.text.endswith("as requested, for errors of stated size")


def test_goes_on_with_the_weakest_parameter_and_a_forecast(pose_data, chosen):
    goal = requests(pose_data, chosen, 0.8)
    goal["s_1"] *= 0.7
    decision = stop_decision(pose_data.of(chosen), pose_data, goal, poses_left=60)
    assert decision.weak[0].name == "s_1"
    assert 3 < int(re.search(r"about (\d+) more poses", decision.text)[1]) < 60
    assert not decision.stop


OUT_OF_REACH = {"alpha_0": 1e-9, "theta_off_1": 1.0}


@pytest.mark.parametrize(
    ("times", "poses_left", "stop", "words"),
    [
        (1, 10, False, "10 more poses would not bring alpha_0"),
        # Ten poses after 1,200.
        (100, 10, True, ""),
        (1, 0, True, "alpha_0 not known as well as requested"),
    ],
)
def test_stops_out_of_reach_when_further_poses_do_not_help(
    pose_data, chosen, times, poses_left, stop, words
):
    information = pose_data.of(list(chosen) * times)
    decision = stop_decision(information, pose_data, OUT_OF_REACH, poses_left=poses_left)
    assert decision.stop is stop
    assert [w.name for w in decision.weak] == ["alpha_0"]
    assert words in decision.text
    if not decision.stop:
        assert decision.weak[0].forecast < decision.weak[0].sigma


def test_forecast_is_bounded_by_the_information_of_all_poses(pose_data, chosen):
    goal = requests(pose_data, chosen, 0.5)
    decision = stop_decision(pose_data.of(chosen), pose_data, goal, poses_left=4)
    root = pose_data.root
    # Four more poses cannot beat four times the whole region's information.
    upper_bound = pose_data.of(chosen) + 4.0 * np.einsum("mrp,mrq->pq", root, root)
    bound = dict(zip(pose_data.parameters, sigmas(upper_bound), strict=True))
    assert all(w.forecast >= bound[w.name] for w in decision.weak)


def test_too_few_poses_determine_no_sigma(pose_data):
    assert np.isinf(sigmas(pose_data.of([0, 1]))).any()
    decision = stop_decision(
        pose_data.of([0, 1]), pose_data, dict.fromkeys(pose_data.parameters, 1.0), poses_left=20
    )
    assert not decision.stop


def test_unknown_parameter_is_rejected(pose_data, chosen):
    with pytest.raises(ValueError, match="a_9"):
        stop_decision(pose_data.of(chosen), pose_data, {"a_9": 1.0}, poses_left=1)

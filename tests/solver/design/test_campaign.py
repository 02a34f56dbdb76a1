from collections.abc import Callable

import numpy as np
import pytest

from solver.chain.parameters import nominal_vector
from solver.design.actions import Capture, GoTo, path_watch
from solver.design.campaign import Campaign, CampaignSettings
from solver.design.interim import InterimEstimate, implicit_interim
from solver.design.plan import PlanningTask
from solver.estimators.implicit import NoiseModel
from tests.oracles.simulated_loops import Simulation
from tests.solver.design.conftest import HOME, SIGMA, of_noise, paper_ranges


@pytest.fixture
def task(loop) -> PlanningTask:
    return PlanningTask(
        model=loop,
        ranges=paper_ranges(),
        margin_rad=np.deg2rad(3.0),
        noise=NoiseModel(joint_variance=SIGMA**2),
        errors=of_noise(SIGMA),
        drive_sets=((1, 5),),
        candidates=250,
    )


def knows(task: PlanningTask, x) -> Callable[[np.ndarray], InterimEstimate]:
    """An interim calibration that knows the truth."""
    known = InterimEstimate(x=x, covariance=np.eye(14) * 1e-12, trusted=True, text="known")
    return lambda _q: known


def at_plan(task: PlanningTask, x, **settings) -> Campaign:
    """A campaign whose interim calibration knows the truth, driven by the model itself."""
    return Campaign(
        task=task, start_rad=HOME, settings=CampaignSettings(**settings), calibrate=knows(task, x)
    )


def drive(campaign: Campaign, task, x, *, stop_planned: int = 0, most: int = 400):
    """Carry out what is proposed on the exact loop; the first planned moves can be stopped."""
    from solver.closing import close_loops

    held = np.ones(7)
    held[[0, 4]] = 0.0
    q, actions = HOME.copy(), []
    for _ in range(most):
        action = campaign.propose()
        actions.append(action)
        if isinstance(action, GoTo):
            goal = q.copy()
            for joint, value in action.targets_rad.items():
                goal[joint - 1] = value
            share = 1.0
            stopped = ""
            if stop_planned and action.trace_rad is not None:
                stop_planned -= 1
                share, stopped = 0.5, "an obstacle"
            if action.trace_rad is not None:
                q = action.trace_rad[-1] if share == 1.0 else q + 0.0
            start = q.copy()
            for part in np.linspace(0.0, share, 12)[1:]:
                q[[0, 4]] = start[[0, 4]] + part * (goal - start)[[0, 4]]
                q = close_loops(task.model, x, q[None, :], sigma_rad=held).q[0]
            campaign.observe(q, stopped)
        elif isinstance(action, Capture):
            campaign.captured(q)
        else:
            return actions
    return actions


@pytest.mark.campaign
def test_precision_asked_for_ends_it_early(task, x) -> None:
    campaign = at_plan(task, x, poses=12, requested={"theta_off_1": 1e-3, "a_0": 1e-3})
    actions = drive(campaign, task, x)
    assert actions[-1].complete
    assert "as well as requested" in actions[-1].text
    assert len(campaign.readings_rad) < 12


@pytest.mark.campaign
def test_precision_out_of_reach_is_said(task, x) -> None:
    campaign = at_plan(task, x, poses=3, requested={"alpha_0": 1e-9})
    actions = drive(campaign, task, x)
    assert actions[-1].text.startswith("all 3 planned poses are taken; alpha_0")
    assert actions[-1].decision.weak[0].name == "alpha_0"


@pytest.mark.campaign
def test_stopped_move_is_taken_back_and_planned_round(task, x) -> None:
    campaign = at_plan(task, x, poses=3)
    actions = drive(campaign, task, x, stop_planned=1)
    whys = [a.why for a in actions if isinstance(a, GoTo)]
    assert any("(an obstacle)" in why for why in whys)
    assert actions[-1].complete


@pytest.mark.campaign
def test_stopped_again_and_again_gives_up(task, x) -> None:
    campaign = at_plan(task, x, poses=3, most_blocked=2)
    actions = drive(campaign, task, x, stop_planned=99)
    assert not actions[-1].complete
    assert actions[-1].text.endswith("repeatedly: an obstacle")


@pytest.mark.campaign
def test_goes_on_from_poses_taken_before_without_exploring_again(task, x) -> None:
    first = at_plan(task, x, poses=3)
    drive(first, task, x)
    taken = first.readings_rad[:-2]
    again = Campaign(
        task=task,
        start_rad=HOME,
        settings=CampaignSettings(poses=3),
        calibrate=knows(task, x),
        captured=taken,
        taken=1,
    )
    assert np.array_equal(again.at_rad, HOME)
    actions = drive(again, task, x)
    assert [a.planned for a in actions if isinstance(a, Capture)] == [True, True]
    assert np.array_equal(again.readings_rad[: len(taken)], taken)
    assert actions[-1].complete


@pytest.mark.campaign
def test_nothing_is_left_to_do_when_all_poses_were_taken_before(task, x) -> None:
    first = at_plan(task, x, poses=3)
    drive(first, task, x)
    again = Campaign(
        task=task,
        start_rad=HOME,
        settings=CampaignSettings(poses=3),
        calibrate=knows(task, x),
        captured=first.readings_rad,
        taken=3,
    )
    assert again.propose().complete


def test_wrong_reports_are_wrong_calls(task) -> None:
    campaign = Campaign(task=task, start_rad=HOME)
    with pytest.raises(ValueError, match="no move"):
        campaign.observe(HOME)
    campaign.propose()
    with pytest.raises(ValueError, match="no capture"):
        campaign.captured(HOME)


def test_interim_calibration_of_a_giving_fixture_is_not_overconfident(loop, x) -> None:
    simulation = Simulation(poses=14, flexure_m=2e-3, flexure_rad=3e-3, wrist_sd=6e-3)
    found = implicit_interim(loop, NoiseModel(joint_variance=SIGMA**2))(simulation.readings(3))
    assert found.trusted
    pull = np.abs(found.x - nominal_vector(loop.parameters)) / np.sqrt(np.diag(found.covariance))
    assert pull.max() < 6.0


def test_watch_names_the_joint_and_the_reason() -> None:
    ranges = paper_ranges()
    trace = HOME + np.linspace(0.0, 0.2, 5)[:, None] * np.array([1.0, 1, 1, 0, 1, 1, 1])
    watch = path_watch(trace, np.deg2rad(5.0), ranges)
    assert watch(trace[2]) is None
    off = trace[2].copy()
    off[3] += np.deg2rad(8.0)
    assert watch(off) == "joint 4 is 8.0 deg from its predicted angle"
    out = HOME.copy()
    out[2] = ranges.upper_rad[2] + 0.01
    assert watch(out) == "joint 3 came close to the end of its range"


def test_watch_lets_a_joint_leave_the_end_of_its_range() -> None:
    ranges = paper_ranges()
    q = HOME.copy()
    q[5] = ranges.lower_rad[5] - 0.01
    watch = path_watch(None, 1.0, ranges)
    assert watch(q) is None
    q[5] += 0.005
    assert watch(q) is None
    q[5] -= 0.02
    assert "joint 6" in watch(q)

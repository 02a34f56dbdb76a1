"""Poses are planned under the errors that a calibration counts with."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.planning.task import planning_task
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.design.plan import information_of, make_plan
from solver.design.stop_rule import standard_deviations
from tests.oracles.as_shipped import ARM, BALL, HINGE, PANDA
from tests.solver.design.conftest import known, of_noise

POSES = 12


@pytest.fixture(scope="module")
def task():
    return planning_task(ARM, HINGE, drive_sets=((1, 5),), samples=32, candidates=500)


@pytest.fixture(scope="module")
def x(task):
    return nominal_vector(task.model.parameters)


@pytest.fixture(scope="module")
def plan(task, x):
    return make_plan(task, x, ARM.home_rad, POSES)


def by_noise_alone(task):
    return replace(task, errors_at=of_noise(ARM.sigma_rad()), toleranced=(), prior={})


def planned_sigma(task, x, q: np.ndarray) -> np.ndarray:
    """Standard deviations (P,) forecast for poses `q` (m, n), none of which is captured yet."""
    loops = close_loops(task.model, x, q)
    before, information = information_of(task, x, q[:0], loops.q, loops.u)
    return standard_deviations(information.of(range(len(q))) + before, len(x))


def captured_sigma(task, x, q: np.ndarray) -> np.ndarray:
    return standard_deviations(known(task, x, q), len(x))


def test_no_entry_is_worse_than_of_poses_planned_by_noise_alone(task, x, plan):
    by_noise = make_plan(by_noise_alone(task), x, ARM.home_rad, POSES)
    ratio = planned_sigma(task, x, plan.poses_rad) / planned_sigma(task, x, by_noise.poses_rad)
    assert ratio.max() < 1.02
    assert np.exp(np.log(ratio).mean()) < 0.9
    # By noise alone they would be known a hundred times better than a calibration knows them.
    assert np.median(by_noise.predicted_sigma / plan.predicted_sigma) < 0.05


def test_the_hundredth_pose_of_one_kind_promises_little(task, x, plan):
    def left(task) -> np.ndarray:
        once = known(task, x, plan.poses_rad)
        return standard_deviations(100.0 * once, len(x)) / standard_deviations(once, len(x))

    assert np.median(left(task)) > 0.25
    assert left(by_noise_alone(task)) == pytest.approx(0.1)


def test_the_scatter_of_captured_poses_scales_the_forecast(task, x, plan):
    q = plan.poses_rad
    noisy = q + np.deg2rad(1.0) * np.random.default_rng(1).standard_normal(q.shape)
    stated = planned_sigma(task, x, q)
    assert np.median(captured_sigma(task, x, noisy) / stated) > 1.5
    # Exact readings show an arm that is better than its file.
    assert np.median(captured_sigma(task, x, q) / stated) < 0.6


def test_what_the_files_state_of_an_offset_counts(task, x, plan):
    """Nobody knows less of an offset after poses than its file says before."""
    stated = replace(task, prior={"theta_off_3": 0.001})
    free, with_prior = (planned_sigma(t, x, plan.poses_rad) for t in (task, stated))
    at = [p.name for p in task.model.parameters].index("theta_off_3")
    assert with_prior[at] == pytest.approx((free[at] ** -2 + 0.001**-2) ** -0.5, rel=1e-3)
    assert (with_prior <= free + 1e-12).all()


def test_a_ball_hides_the_first_and_the_last_offset_and_a_hinge_none():
    """As unknowns of a plan they would make every sigma infinite or absurd."""
    ball, hinge = (planning_task(PANDA, fixture, drive_sets=None) for fixture in (BALL, HINGE))
    names = {p.name for p in ball.model.parameters}
    assert names == {
        *(f"theta_off_{j}" for j in range(2, 7)),
        *(f"{side}_{axis}" for side in ("tip", "ground") for axis in "xyz"),
    }
    assert set(ball.parameters or ()) == names
    assert {"theta_off_1", "theta_off_7"} < {p.name for p in hinge.model.parameters}

"""Poses are planned under all errors of a calibration."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.planning.task import planning_task
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.design.plan import information_of, make_plan
from solver.design.stop_rule import standard_deviations
from tests.oracles.as_shipped import ARM, BALL, HINGE, PANDA
from tests.solver.design.conftest import information_of_captured_poses, of_noise

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
    before, information = information_of(task, x, q[:0], close_loops(task.model, x, q))
    return standard_deviations(information.of(range(len(q))) + before, len(x))


def captured_sigma(task, x, q: np.ndarray) -> np.ndarray:
    return standard_deviations(information_of_captured_poses(task, x, q), len(x))


def test_plan_beats_a_plan_by_noise_alone(task, x, plan):
    noise_plan = make_plan(by_noise_alone(task), x, ARM.home_rad, POSES)
    ratio = planned_sigma(task, x, plan.poses_rad) / planned_sigma(task, x, noise_plan.poses_rad)
    assert ratio.max() < 1.02
    assert np.exp(np.log(ratio).mean()) < 0.9
    # Noise alone promises sigmas a hundred times too small.
    assert np.median(noise_plan.predicted_sigma / plan.predicted_sigma) < 0.05


def test_repeated_poses_narrow_sigmas_little(task, x, plan):
    def remaining_share(task) -> np.ndarray:
        once = information_of_captured_poses(task, x, plan.poses_rad)
        return standard_deviations(100.0 * once, len(x)) / standard_deviations(once, len(x))

    assert np.median(remaining_share(task)) > 0.25
    assert remaining_share(by_noise_alone(task)) == pytest.approx(0.1)


def test_scatter_of_captured_poses_scales_the_forecast(task, x, plan):
    q = plan.poses_rad
    noisy = q + np.deg2rad(1.0) * np.random.default_rng(1).standard_normal(q.shape)
    stated = planned_sigma(task, x, q)
    assert np.median(captured_sigma(task, x, noisy) / stated) > 1.5
    # Exact readings show an arm that is better than its file.
    assert np.median(captured_sigma(task, x, q) / stated) < 0.6


def test_prior_of_an_offset_is_used(task, x, plan):
    stated = replace(task, prior={"theta_off_3": 0.001})
    free, with_prior = (planned_sigma(t, x, plan.poses_rad) for t in (task, stated))
    at = [p.name for p in task.model.parameters].index("theta_off_3")
    assert with_prior[at] == pytest.approx((free[at] ** -2 + 0.001**-2) ** -0.5, rel=1e-3)
    assert (with_prior <= free + 1e-12).all()


def test_ball_plan_omits_first_and_last_offset():
    ball, hinge = (planning_task(PANDA, fixture, drive_sets=None) for fixture in (BALL, HINGE))
    names = {p.name for p in ball.model.parameters}
    assert names == {
        *(f"theta_off_{j}" for j in range(2, 7)),
        *(f"{side}_{axis}" for side in ("tip", "ground") for axis in "xyz"),
    }
    assert set(ball.parameters or ()) == names
    assert {"theta_off_1", "theta_off_7"} < {p.name for p in hinge.model.parameters}

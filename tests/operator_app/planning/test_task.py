"""Poses are planned under the errors that a calibration counts with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.planning.task import planning_task
from solver.chain.parameters import nominal_vector
from solver.design.plan import information_of, make_plan
from solver.design.stop_rule import standard_deviations
from tests.solver.design.conftest import of_noise

ARM = load_arm("sarcos_dextrous")
POSES = 12


@pytest.fixture(scope="module")
def task():
    hinge = load_fixture("hinge").fixture
    return planning_task(ARM, hinge, drive_sets=((1, 5),), samples=32, candidates=500)


@pytest.fixture(scope="module")
def x(task):
    return nominal_vector(task.model.parameters)


@pytest.fixture(scope="module")
def plan(task, x):
    return make_plan(task, x, ARM.home_rad, POSES)


def combined(task, x, q: np.ndarray) -> np.ndarray:
    return standard_deviations(information_of(task, x, q).of(range(len(q))), len(x))


def test_no_entry_is_worse_than_of_poses_planned_by_noise_alone(task, x, plan) -> None:
    by_noise = make_plan(replace(task, errors=of_noise(ARM.sigma_rad())), x, ARM.home_rad, POSES)
    ratio = combined(task, x, plan.poses_rad) / combined(task, x, by_noise.poses_rad)
    assert ratio.max() < 1.02
    assert np.exp(np.log(ratio).mean()) < 0.9
    # By noise alone they would be known a hundred times better than a calibration knows them.
    assert np.median(by_noise.predicted_sigma / plan.predicted_sigma) < 0.05


def test_the_hundredth_pose_of_one_kind_promises_little(task, x, plan) -> None:
    def left(task) -> np.ndarray:
        once = information_of(task, x, plan.poses_rad).of(range(POSES))
        return standard_deviations(100.0 * once, len(x)) / standard_deviations(once, len(x))

    assert np.median(left(task)) > 0.25
    assert left(replace(task, errors=of_noise(ARM.sigma_rad()))) == pytest.approx(0.1)


def test_captured_poses_that_scatter_more_than_stated_widen_the_forecast(task, x, plan) -> None:
    q = plan.poses_rad
    quiet, loud = (
        information_of(task, x, q + size * np.random.default_rng(1).standard_normal(q.shape))
        for size in (0.0, np.deg2rad(1.0))
    )
    assert quiet.error_scale() == 1.0
    # What it is scaled by is no longer unexplained.
    assert loud.error_scale() == pytest.approx(1.0, abs=1e-6)
    wide, narrow = (standard_deviations(t.of(range(POSES)), len(x)) for t in (loud, quiet))
    assert np.median(wide / narrow) > 3.0

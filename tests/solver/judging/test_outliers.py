"""Wrong poses are named, all of them and no others; sound ones hardly ever."""

from __future__ import annotations

import numpy as np
import pytest

from solver.estimators.implicit import NoiseModel, fit_implicit
from solver.judging.outliers import outlier_poses
from tests.oracles.loop_oracle import Truth
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import NAMES, loop_of

SIMULATION = Simulation(poses=30, wrist_sd=6e-3)
NOISE = NoiseModel(joint_variance=SIMULATION.sigma() ** 2)


@pytest.mark.parametrize(
    ("wrong", "by_rad"),
    [({4: 2}, 2e-3), ({0: 6}, 0.05), ({3: 0, 17: 1}, 5e-3), ({5: 1, 6: 1, 20: 3}, 0.02)],
)
def test_wrong_readings_are_named(truth: Truth, wrong: dict[int, int], by_rad: float) -> None:
    model, q = loop_of(truth), SIMULATION.rereadings(2)
    for pose, joint in wrong.items():
        q[pose, joint] += by_rad
    x = fit_implicit(model, q, NOISE, truth.values(NAMES)).x
    found = outlier_poses(model, q, NOISE, x)
    assert {o.pose for o in found} == set(wrong)
    assert all(o.probability < 0.01 for o in found)
    # left out, they leave a pose set without any
    rest = np.delete(q, list(wrong), axis=0)
    again = fit_implicit(model, rest, NOISE, x)
    assert outlier_poses(model, rest, NOISE, again.x) == ()


def test_sound_poses_are_hardly_ever_named(truth: Truth) -> None:
    model, named, runs = loop_of(truth), 0, 60
    for seed in range(runs):
        q = SIMULATION.rereadings(seed)
        x = fit_implicit(model, q, NOISE, truth.values(NAMES)).x
        named += bool(outlier_poses(model, q, NOISE, x))
    # At 1 % a run: more than 4 of 60 has a chance of 4e-4.
    assert named <= 4


def test_misfit_of_a_named_pose_is_the_size_of_its_error(truth: Truth) -> None:
    # One reading off by k standard deviations misses by at most k^2, most of it when others know it.
    model, q = loop_of(truth), SIMULATION.rereadings(4)
    q[7, 6] += 12 * 6e-3
    x = fit_implicit(model, q, NOISE, truth.values(NAMES)).x
    (found,) = outlier_poses(model, q, NOISE, x)
    assert found.pose == 7
    assert found.dof == 5
    assert 20.0 < found.chi2 < 250.0


def test_a_pose_that_cannot_close_is_named(truth: Truth) -> None:
    model, q = loop_of(truth), SIMULATION.rereadings(4)
    q[11] += np.array([0.3, -0.3, 0.3, 0.2, -0.2, 0.3, 0.3])
    x = truth.values(NAMES)
    assert [o.pose for o in outlier_poses(model, q, NOISE, x)] == [11]

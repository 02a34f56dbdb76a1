"""Readings adjusted to fixed parameters."""

from dataclasses import replace

import numpy as np

from solver.diagnostics.pose_adjustment import adjust_poses
from solver.estimators.implicit import NoiseModel
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import NAMES, loop_of


def test_iteration_goes_on_after_a_zero_step_of_one_pose(truth):
    """Its ratio of steps is 0/0."""
    rigid = replace(loop_of(truth), hinge=False)
    q = Simulation(poses=6, wrist_sd=6e-3).readings(0)
    variance = np.full(q.shape, 1e-6)
    variance[0] = 0.0
    noise = NoiseModel(joint_variance=variance, fixture_variance=np.full(6, 1e-6))
    result = adjust_poses(rigid, truth.values(NAMES), q, noise)
    assert result.converged.all()
    assert not result.corrections[0].any()
    assert result.corrections[1:].any()

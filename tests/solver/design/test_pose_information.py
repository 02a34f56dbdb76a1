import numpy as np
import pytest

from solver.design.pose_information import pose_information
from tests.oracles.loop_oracle import information, paper_truth
from tests.solver.design.conftest import SIGMA, of_noise

TRUTH = paper_truth()


def test_agrees_with_the_oracle(loop, x, region, told):
    poses = [0, 5, 50, 200, 400, 700]
    angles = np.concatenate((region.u[poses], region.q[poses]), axis=1)
    expected = information(TRUTH, angles, told.parameters, SIGMA**2)
    scale = np.sqrt(np.diag(expected))
    assert told.of(poses) / np.outer(scale, scale) == pytest.approx(
        expected / np.outer(scale, scale), abs=1e-7
    )


def test_unsensed_joints_tell_nothing_about_themselves_and_leave_the_rest(loop, x, region):
    poses = [0, 5, 50, 200, 400, 700, 900]
    q, sigma = region.q[poses], SIGMA.copy()
    sigma[5:] = 1.0
    told = pose_information(loop, x, q, q, region.u[poses], of_noise(sigma)(q))
    names = [n for n in told.parameters if n not in ("theta_off_6", "theta_off_7")]
    mine = told.about(names).of(range(len(poses)))
    angles = np.concatenate((region.u[poses], region.q[poses]), axis=1)
    expected = information(TRUTH, angles, names, SIGMA**2, unsensed=(6, 7))
    scale = np.sqrt(np.diag(expected))
    assert mine / np.outer(scale, scale) == pytest.approx(
        expected / np.outer(scale, scale), abs=1e-4
    )


def test_joints_without_noise_are_refused(loop, x, region):
    q = region.q[:2]
    with pytest.raises(ValueError, match="have no noise"):
        pose_information(loop, x, q, q, region.u[:2], of_noise(np.zeros(7))(q))

import numpy as np
import pytest

from solver.design.pose_information import pose_information
from tests.oracles.loop_oracle import information, paper_truth
from tests.solver.design.conftest import SIGMA, of_noise

TRUTH = paper_truth()


def assert_agrees(information: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    sigma = np.sqrt(np.diag(expected))
    scale = np.outer(sigma, sigma)
    assert information / scale == pytest.approx(expected / scale, abs=tolerance)


def test_information_agrees_with_the_oracle(region, pose_data):
    poses = [0, 5, 50, 200, 400, 700]
    angles = np.concatenate((region.u[poses], region.q[poses]), axis=1)
    expected = information(TRUTH, angles, pose_data.parameters, SIGMA**2)
    assert_agrees(pose_data.of(poses), expected, 1e-7)


def test_noisy_joints_count_as_unsensed(loop, x, region):
    poses = [0, 5, 50, 200, 400, 700, 900]
    q, sigma = region.q[poses], SIGMA.copy()
    sigma[5:] = 1.0
    data = pose_information(loop, x, q, q, region.u[poses], of_noise(sigma)(q))
    names = [n for n in data.parameters if n not in ("theta_off_6", "theta_off_7")]
    angles = np.concatenate((region.u[poses], region.q[poses]), axis=1)
    expected = information(TRUTH, angles, names, SIGMA**2, unsensed=(6, 7))
    assert_agrees(data.about(names).of(range(len(poses))), expected, 1e-4)


def test_joints_without_noise_are_rejected(loop, x, region):
    q = region.q[:2]
    with pytest.raises(ValueError, match="have no noise"):
        pose_information(loop, x, q, q, region.u[:2], of_noise(np.zeros(7))(q))

"""Rotation vectors and their differentials against pinocchio, also near 0 and pi."""

import numpy as np
import pinocchio as pin
import pytest

from solver.chain.rotations import rotation_matrix, rotation_vector, rotation_vector_differential

ANGLES = (0.0, 1e-300, 1e-12, 1e-8, 1e-6, 0.99e-4, 1e-4, 1.01e-4, 1e-2, 1.0, 2.0, 3.0, 3.14)
NEAR_PI = tuple(np.pi - d for d in (1e-2, 1e-4, 1e-6, 1e-9, 1e-12))


def directions(count: int = 6) -> np.ndarray:
    v = np.random.default_rng(1).normal(size=(count, 3))
    v = np.concatenate((v, np.eye(3), -np.eye(3)))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES + NEAR_PI)
def test_rotation_vector_inverts_the_exponential(angle):
    v = angle * directions()
    R = np.stack([pin.exp3(row) for row in v])
    assert rotation_vector(R) == pytest.approx(v, rel=1e-11, abs=1e-14)
    assert rotation_matrix(v) == pytest.approx(R, abs=1e-15)


def test_rotation_vector_of_a_half_turn():
    for axis in directions():
        R = 2.0 * np.outer(axis, axis) - np.eye(3)
        v = rotation_vector(R)
        assert np.linalg.norm(v) == pytest.approx(np.pi, abs=1e-14)
        assert abs(v @ axis) == pytest.approx(np.pi, abs=1e-13)


@pytest.mark.parametrize("angle", [0.0, *ANGLES[2:], np.pi - 1e-2, np.pi - 1e-4])
def test_differential_agrees_with_pinocchio(angle):
    for axis in directions():
        R = pin.exp3(angle * axis)
        expected = pin.Jlog3(R) @ R.T
        differential = rotation_vector_differential(angle * axis)
        assert np.abs(differential - expected).max() < (1e-12 if angle < 3.0 else 1e-10)

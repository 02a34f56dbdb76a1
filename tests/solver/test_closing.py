"""Null-space reduction and loop closing against NumPy's and SciPy's least squares."""

import numpy as np
import pytest
from scipy.linalg import lstsq, null_space

from solver.chain.parameters import nominal_vector
from solver.closing import (
    close_loops,
    left_inverse,
    left_null_space,
    measure_with_fixed,
    newton_step,
    reduced_equations,
)
from solver.loops.closure import LoopError
from tests.oracles.loop_oracle import closed_poses, paper_truth
from tests.solver.conftest import loop_of

SIGMA = np.array([5e-6] * 5 + [6e-3] * 2)


def random_loops(seed: int, unsensed: int, poses: int = 20) -> LoopError:
    rng = np.random.default_rng(seed)
    return LoopError(
        residual=rng.normal(size=(poses, 6)),
        jac_x=rng.normal(size=(poses, 6, 14)),
        jac_q=rng.normal(size=(poses, 6, 7)),
        jac_u=rng.normal(size=(poses, 6, unsensed)),
    )


@pytest.mark.parametrize("unsensed", [0, 1, 2, 3, 5])
def test_left_null_space_is_orthonormal(unsensed):
    N = random_loops(unsensed, unsensed).jac_u
    E = left_null_space(N)
    assert E.shape == (20, 6, 6 - unsensed)
    assert np.abs(np.swapaxes(E, -1, -2) @ E - np.eye(6 - unsensed)).max() < 1e-14
    assert np.abs(np.swapaxes(E, -1, -2) @ N).max(initial=0.0) < 1e-14


@pytest.mark.parametrize(
    "column",
    [
        (1.0, 0, 0, 0, 0, 0),
        (-1.0, 0, 0, 0, 0, 0),
        (0, 0, 1.0, 0, 0, 0),
        (1e-150, 0, 1e-140, 0, 0, 0),
        (-1e-17, 0, 1.0, 1e-17, 0, 0),
        (1e150, -1e150, 0, 0, 0, 0),
    ],
)
def test_left_null_space_of_extreme_columns(column):
    N = np.array(column)[:, None]
    E = left_null_space(N)
    assert np.abs(E.T @ E - np.eye(5)).max() < 1e-15
    assert np.abs(E.T @ N).max() < 1e-15 * np.abs(N).max()


def test_left_null_space_of_a_zero_column():
    E = left_null_space(np.zeros((6, 1)))
    assert E.shape == (6, 5)
    assert np.abs(E.T @ E - np.eye(5)).max() == 0.0


@pytest.mark.parametrize("unsensed", [1, 2, 3])
def test_left_inverse_solves_least_squares(unsensed):
    error = random_loops(unsensed, unsensed)
    for N, c, inverse in zip(error.jac_u, error.residual, left_inverse(error.jac_u), strict=True):
        np.testing.assert_allclose(inverse @ c, np.linalg.lstsq(N, c, rcond=None)[0], atol=1e-12)


@pytest.mark.parametrize("unsensed", [0, 1, 3])
@pytest.mark.parametrize("fixed", [(), (2,)])
def test_newton_step_is_the_smallest_closing_step(unsensed, fixed):
    error = random_loops(7 + unsensed, unsensed)
    sigma = SIGMA * measure_with_fixed(fixed, 7)
    dq, du = newton_step(error, sigma)
    moving = [j for j in range(7) if sigma[j] > 0.0]
    for k in range(20):
        # Minimise |dq / sigma|^2 subject to c + J_q dq + N du = 0, by SciPy's null space and SVD.
        c, N = error.residual[k], error.jac_u[k]
        J = error.jac_q[k][:, moving]
        Z = null_space(N.T) if unsensed else np.eye(6)
        expected = lstsq(Z.T @ J * sigma[moving], -Z.T @ c, cond=1e-13)[0] * sigma[moving]
        # Weighted as in the minimisation. Normal equations lose the squared ratio of the sensors' sigmas,
        # 1e6, times the condition of J; the next Newton step corrects it.
        deviation = (dq[k][moving] - expected) / sigma[moving]
        assert np.linalg.norm(deviation) < 1e-5 * np.linalg.norm(expected / sigma[moving])
        np.testing.assert_allclose(c + error.jac_q[k] @ dq[k] + N @ du[k], 0.0, atol=1e-5)
        assert not dq[k][[j for j in range(7) if j not in moving]].any()


@pytest.mark.parametrize("fixed", [5, 3])
def test_newton_step_with_few_free_joints_minimises_the_misclosure(fixed):
    error = random_loops(3, 1, poses=100)
    dq, _ = newton_step(error, measure_with_fixed(range(1, fixed + 1), 7))
    reduced = reduced_equations(error)
    for B, w, step in zip(reduced.B, reduced.w, dq, strict=True):
        expected = np.linalg.lstsq(B[:, fixed:], -w, rcond=None)[0]
        np.testing.assert_allclose(step[fixed:], expected, rtol=1e-9, atol=1e-12)


@pytest.fixture(scope="module")
def loop():
    """The paper's loop: truth, model and nominal parameters."""
    truth = paper_truth()
    model = loop_of(truth)
    return truth, model, nominal_vector(model.parameters)


def test_closed_pose_is_independent_of_its_batch(loop):
    truth, model, x = loop
    rng = np.random.default_rng(4)
    q = closed_poses(truth, rng, 12)[:, 1:] + rng.normal(size=(12, 7)) * 0.05
    together = close_loops(model, x, q)
    assert together.closed.all()
    assert np.abs(model.loop(x, together.q, together.u).residual).max() < 1e-11
    for k in range(12):
        alone = close_loops(model, x, q[k : k + 1])
        np.testing.assert_allclose(alone.q[0], together.q[k], rtol=0, atol=1e-13)


def test_with_all_joints_fixed_only_the_hinge_turns(loop):
    truth, model, x = loop
    q = closed_poses(truth, np.random.default_rng(5), 4)[:, 1:] + 1e-3
    poses = close_loops(model, x, q, sigma_rad=np.zeros(7))
    np.testing.assert_array_equal(poses.q, q)
    assert not poses.closed.any()

    def misclosure(turn: float) -> np.ndarray:
        return (model.loop(x, q, poses.u + turn).residual ** 2).sum(-1)

    assert np.all(misclosure(0.0) <= np.minimum(misclosure(1e-6), misclosure(-1e-6)))

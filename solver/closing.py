"""Closing loops: the smallest joint corrections that make measured poses fit a model exactly.

Used wherever something must be judged on the manifold itself and not beside it: rank and condition,
planned poses, the plant's start. Knows a `ClosureModel`, no estimator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.loops.closure import ClosureModel


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosedPoses:
    """Poses moved onto the closure manifold.

    Attributes
    ----------
    q, u
        Joint angles (..., m, n) and unsensed angles (..., m, U), rad.
    closed
        (..., m) bool: whether the loop error fell below the tolerance.
    """

    q: FloatArray
    u: FloatArray
    closed: BoolArray


def close_loops(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    *,
    sigma_rad: FloatArray | None = None,
    u: FloatArray | None = None,
    max_iterations: int = 30,
    tolerance: float = 1e-12,
    max_step_rad: float = 0.5,
) -> ClosedPoses:
    """Project poses onto the loops that parameters `x` describe, by Gauss-Newton.

    Parameters
    ----------
    x
        Parameters (P,).
    q
        Joint angles (m, n), rad.
    sigma_rad
        Standard deviation of each joint (n,): the correction is the smallest in this measure
        (default: all joints alike). A joint with 0 stays where it is.
    u
        First values of the unsensed angles (m, U); by default the model's own.
    max_step_rad
        Longest correction of a joint in one iteration.
    """
    q = np.array(q, dtype=np.float64)
    u = np.array(model.initial_unsensed(x, q) if u is None else u, dtype=np.float64)
    weight = np.ones(q.shape[-1]) if sigma_rad is None else np.asarray(sigma_rad)
    # Unsensed angles move freely: give them a weight far above every sensed joint's.
    free = 1e3 * float(np.max(weight))
    error = model.loop(x, q, u)
    for _ in range(max_iterations):
        size = np.abs(error.residual).max(-1, initial=0.0)
        if bool(np.all(size < tolerance)):
            break
        J = np.concatenate((error.jac_q * weight, error.jac_u * free), axis=-1)
        step = -(np.linalg.pinv(J, rcond=1e-10) @ error.residual[..., None])[..., 0]
        dq, du = step[..., : q.shape[-1]] * weight, step[..., q.shape[-1] :] * free
        longest = np.concatenate((np.abs(dq), np.abs(du)), axis=-1).max(-1, keepdims=True)
        shrink = np.minimum(1.0, max_step_rad / np.maximum(longest, 1e-300))
        q += dq * shrink
        u += du * shrink
        error = model.loop(x, q, u)
    closed = np.abs(error.residual).max(-1, initial=0.0) < max(100.0 * tolerance, 1e-9)
    return ClosedPoses(q=q, u=u, closed=closed)


def reduced_jacobian(
    model: ClosureModel, x: FloatArray, q: FloatArray, u: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Parameter and joint Jacobians with the unsensed freedoms projected out.

    Returns
    -------
    A, B
        (..., m, r, P) and (..., m, r, n): ``E' J_x`` and ``E' J_q`` with E the left null space of
        the columns of the unsensed joints (method, section 3).
    """
    error = model.loop(x, q, u)
    E = left_null_space(error.jac_u)
    Et = np.swapaxes(E, -1, -2)
    return Et @ error.jac_x, Et @ error.jac_q


def left_null_space(N: FloatArray) -> FloatArray:
    """Orthonormal E (..., k, k - U) with ``E' N = 0`` for N of shape (..., k, U) and rank U."""
    k, unsensed = N.shape[-2:]
    if unsensed == 0:
        return np.broadcast_to(np.eye(k), (*N.shape[:-1], k))
    Q = np.linalg.qr(N, mode="complete").Q
    return Q[..., unsensed:]

"""Thousands of nearly closed poses onto their loops, quickly, with joints held where wanted.

`solver.closing.close_loops` weighs joints and survives any rank; planning starts within a small step
of regular poses and needs neither: normal equations of size six and no singular values, several
times faster. Knows a `ClosureModel` only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.arrays import FloatArray
from solver.closing import ClosedPoses
from solver.loops.closure import ClosureModel

RIDGE = 1e-12
"""Relative ridge that keeps a singular pose from raising; such a pose does not converge."""
LONGEST_STEP_RAD = 0.5


def project(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    u: FloatArray,
    *,
    held: Sequence[int] = (),
    iterations: int = 6,
    tolerance: float = 1e-10,
) -> ClosedPoses:
    """Smallest joint corrections, by Gauss-Newton, that close the loops `x` (P,) near `q` (m, n).

    Parameters
    ----------
    u
        Unsensed angles (m, U) to start from; they move like joints.
    held
        Joints (1-based) that stay where they are.
    """
    q, u = np.array(q, dtype=np.float64), np.array(u, dtype=np.float64)
    n = q.shape[-1]
    held_columns = [j - 1 for j in held]
    closed = np.zeros(len(q), dtype=np.bool_)
    left = np.arange(len(q))
    for iteration in range(iterations + 1):
        error = model.loop(x, q[left], u[left])
        done = np.abs(error.residual).max(-1, initial=0.0) < tolerance
        closed[left[done]] = True
        going = ~done
        if iteration == iterations or not going.any():
            break
        left = left[going]
        J = np.concatenate((error.jac_q[going], error.jac_u[going]), axis=-1)
        J[..., held_columns] = 0.0
        Jt = np.swapaxes(J, -1, -2)
        N = J @ Jt
        N += RIDGE * np.trace(N, axis1=-2, axis2=-1)[:, None, None] * np.eye(N.shape[-1])
        step = -(Jt @ np.linalg.solve(N, error.residual[going][..., None]))[..., 0]
        longest = np.abs(step).max(-1, keepdims=True)
        step *= np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(longest, 1e-300))
        q[left] += step[:, :n]
        u[left] += step[:, n:]
    return ClosedPoses(q=q, u=u, closed=closed)

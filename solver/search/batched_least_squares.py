"""Damped Gauss-Newton from many starts at once. Knows residuals with a leading axis of starts, not arms.

Every start has its own damping; starts that have arrived leave the batch. Accuracy is that of a
search, not of an estimate: what it finds is polished elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.estimators.least_squares import Progress

BatchProblem = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Unknowns (S, K) to residuals (S, R) and Jacobian (S, R, K)."""

FIRST_DAMPING = 1e-2
EASIER, HARDER = 0.2, 5.0
STUCK_DAMPING = 1e7
STEP_TOLERANCE = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchFit:
    """Where each start ended: unknowns (S, K) and sum of squared residuals (S,)."""

    x: FloatArray
    cost: FloatArray


def minimise_batch(
    problem: BatchProblem,
    x0: FloatArray,
    *,
    max_iterations: int = 40,
    max_step: float = 0.7,
    halt_after: int | None = None,
    survivors: int = 0,
    progress: Progress | None = None,
) -> BatchFit:
    """Minimise the sum of squares from every row of `x0` (S, K).

    Parameters
    ----------
    max_step
        Longest component of one step: beyond it a linearised rotation means nothing.
    halt_after, survivors
        After this many iterations only so many of the starts go on, those of least cost; the rest
        stay where they are. What is going to arrive is nearly always ahead by then.
    """
    x = np.array(x0, dtype=np.float64)
    r, J = problem(x)
    cost = np.einsum("sr,sr->s", r, r)
    damping = np.full(len(x), FIRST_DAMPING)
    active = np.arange(len(x))
    for iteration in range(1, max_iterations + 1):
        Jt = np.swapaxes(J, -1, -2)
        N, gradient = Jt @ J, (Jt @ r[..., None])[..., 0]
        diagonal = np.diagonal(N, axis1=-2, axis2=-1)
        # Marquardt's scaling; a column of zeros still needs something to divide by.
        tiny = 1e-12 * diagonal.max(-1, keepdims=True) + 1e-300
        N = N + (damping[active, None] * diagonal + tiny)[..., None] * np.eye(x.shape[1])
        step = -np.linalg.solve(N, gradient[..., None])[..., 0]
        longest = np.abs(step).max(-1)
        step *= np.minimum(1.0, max_step / np.maximum(longest, 1e-300))[:, None]
        trial = x[active] + step
        r_new, J_new = problem(trial)
        cost_new = np.einsum("sr,sr->s", r_new, r_new)
        better = cost_new < cost[active]
        x[active[better]], cost[active[better]] = trial[better], cost_new[better]
        r, J = (
            np.where(better[:, None], r_new, r),
            np.where(better[:, None, None], J_new, J),
        )
        damping[active] *= np.where(better, EASIER, HARDER)
        if progress is not None:
            progress(iteration, float(cost.min()))
        going = (longest > STEP_TOLERANCE) & (damping[active] < STUCK_DAMPING)
        if iteration == halt_after:
            going &= np.isin(active, np.argsort(cost, kind="stable")[:survivors])
        active, r, J = active[going], r[going], J[going]
        if not len(active):
            break
    return BatchFit(x=x, cost=cost)

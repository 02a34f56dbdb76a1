"""Damped, column-scaled Gauss-Newton for stacked closure equations. Knows residuals, not arms.

Minimises ``|r(x)|^2`` (paper, eqs. 5 and 6, iterated). Columns are scaled to unit norm [13], which
makes the damping independent of units and is where the scaled condition number comes from. The
undamped step is tried first and taken whenever it descends; damping (Levenberg-Marquardt) only
steps in when it does not, so the iteration never diverges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray

Problem = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Parameters (P,) to residuals (R,) and Jacobian (R, P)."""

Progress = Callable[[int, float], None]
"""Called after each iteration with its number and the cost; may raise to cancel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Where the iteration ended.

    Attributes
    ----------
    x
        Parameters (P,).
    cost
        Half the sum of squared residuals.
    iterations
        Accepted steps.
    converged
        Whether the last step was below `step_tolerance`, or nothing smaller than it descends.
    """

    x: FloatArray
    cost: float
    iterations: int
    converged: bool


def column_scale(J: FloatArray) -> FloatArray:
    """Column norms (P,), 1 where a column is zero, so that ``J / scale`` has unit columns."""
    norms = np.linalg.norm(J, axis=0)
    return np.where(norms > 0.0, norms, 1.0)


def solve_damped(
    problem: Problem,
    x0: FloatArray,
    *,
    max_iterations: int = 100,
    step_tolerance: float = 1e-13,
    progress: Progress | None = None,
) -> Fit:
    """Iterate from `x0` until the steps vanish.

    Parameters
    ----------
    problem
        Residuals and their exact Jacobian.
    step_tolerance
        Largest component of a step (rad, m) that counts as no step.
    """
    x = np.array(x0, dtype=np.float64)
    r, J = problem(x)
    cost = 0.5 * float(r @ r)
    damping = 0.0
    for iteration in range(1, max_iterations + 1):
        scale = column_scale(J)
        U, s, Vt = np.linalg.svd(J / scale, full_matrices=False)
        # Directions the equations do not see get no step at all, rather than a huge one.
        seen = s > 1e-12 * s[0]
        beta = U.T @ r
        while True:
            gain = np.where(seen, s / np.where(seen, s**2 + damping, 1.0), 0.0)
            step = -(Vt.T @ (gain * beta)) / scale
            largest = float(np.max(np.abs(step), initial=0.0))
            r_new, J_new = problem(x + step)
            cost_new = 0.5 * float(r_new @ r_new)
            if np.isfinite(cost_new) and cost_new < cost:
                damping = 0.0 if damping < 1e-8 else damping / 10.0
                break
            if largest < step_tolerance:
                return Fit(x=x, cost=cost, iterations=iteration - 1, converged=True)
            # At the floor of rounding no step descends any more; that is the minimum.
            predicted = 0.5 * float(((gain * s * (2.0 - gain * s)) * beta**2).sum())
            if predicted <= 1e-14 * cost + 1e-300:
                return Fit(x=x, cost=cost, iterations=iteration - 1, converged=True)
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e12:
                return Fit(x=x, cost=cost, iterations=iteration - 1, converged=False)
        x, r, J, cost = x + step, r_new, J_new, cost_new
        if progress is not None:
            progress(iteration, cost)
        if largest < step_tolerance:
            return Fit(x=x, cost=cost, iterations=iteration, converged=True)
    return Fit(x=x, cost=cost, iterations=max_iterations, converged=False)

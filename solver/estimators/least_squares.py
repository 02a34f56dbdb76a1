"""Damped, column-scaled Gauss-Newton for stacked closure equations.

Minimises ``|r(x)|^2`` (paper, eqs. 5 and 6, iterated). Columns are scaled to unit norm [13], which makes the damping
independent of units and gives the scaled condition number. The undamped step is tried first and taken if it lowers the
cost; otherwise the step is damped (Levenberg-Marquardt) until it does. Only the triangular QR factor is kept
(`triangle_of`), whose size does not grow with the number of poses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray

UNSEEN = 1e-12
"""A scaled singular value below this share of the largest belongs to an undetermined direction."""

WELL_SEEN = 1e-6
"""If the reciprocal condition of the scaled triangle is above this, all directions are determined."""

LAST_SHARE = 1e-12
"""A step that would lower the cost by less than this share of the cost is the last. This step is taken without
evaluation, because it is only 1e-5 of the parameters' standard deviations."""

LEFT_SHARE = 1e-14
"""An undamped step is also the last if the step after it is expected to lower the cost by less than this share. The
reductions of the cost by successive undamped steps have a nearly constant ratio, which gives this expectation."""

LEAST_STEP = 1e-13
"""Largest component of a step (rad, m) that counts as converged."""

BLOCK_ROWS = 2048
"""Number of rows of a block: with some tens of columns the block fits in a core's cache."""

Progress = Callable[[int, float], None]
"""Called after each iteration with its number and the cost; may raise to cancel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Triangle:
    """Residuals r (R,) and their Jacobian J (R, P), reduced by a QR factorisation to P rows for any number R.

    ``|r + J dx|^2 = |b + T dx|^2 + rest`` for every dx, and ``J' J = T' T``.

    `T` (P, P): upper triangle of the QR factors of J. `b` (P,): residuals rotated into the rows of T. `rest`: sum of
    squares of the part of the residuals that no dx changes.
    """

    T: FloatArray
    b: FloatArray
    rest: float

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals."""
        return 0.5 * (float(self.b @ self.b) + self.rest)

    def after(self, step: FloatArray) -> Triangle:
        """Return the triangle at the parameters after a step (P,), in linear approximation: only `b` changes."""
        return replace(self, b=self.b + self.T @ step)

    def step(self, damping: float = 0.0) -> tuple[FloatArray, float]:
        """Return the step (P,) with Levenberg-Marquardt `damping`, and the reduction of the cost expected from it.

        The step is zero along undetermined directions, and nan if the equations contain nan.
        """
        from scipy.linalg import lapack

        if not np.isfinite(self.T).all():
            return np.full(len(self.b), np.nan), np.nan
        if damping == 0.0 and self._full_rank():
            plain, _ = lapack.dtrtrs(self.T, self.b)
            return np.asarray(-plain), 0.5 * float(self.b @ self.b)
        scale = column_scale(self.T)
        U, s, Vt = np.linalg.svd(self.T / scale)
        determined = s > UNSEEN * s[0]
        gain = np.where(determined, s / np.where(determined, s**2 + damping, 1.0), 0.0)
        beta = U.T @ self.b
        lower = 0.5 * float(((gain * s * (2.0 - gain * s)) * beta**2).sum())
        return -(Vt.T @ (gain * beta)) / scale, lower

    def covariance(self) -> FloatArray:
        """Return ``(J' J)^-1`` (P, P), or the pseudo-inverse if some directions may be undetermined."""
        from scipy.linalg import lapack

        if not self._full_rank():
            return np.asarray(np.linalg.pinv(self.T.T @ self.T, hermitian=True))
        inverse, _ = lapack.dtrtri(self.T)
        return np.asarray(inverse @ inverse.T)

    def _full_rank(self) -> bool:
        from scipy.linalg import lapack

        condition, _ = lapack.dtrcon(self.T / column_scale(self.T))
        return bool(condition > WELL_SEEN)


def triangle_of(blocks: Iterable[tuple[FloatArray, FloatArray]]) -> Triangle:
    """Return the triangle of residuals (..., r) and Jacobians (..., r, P), factorised block by block (TSQR).

    Each block is triangularised together with the triangle of all blocks before it, so that memory does not grow with
    the number of rows, and J'J is never formed.
    """
    triangle = stacked_triangle(np.concatenate((J, r[..., None]), axis=-1) for r, J in blocks)
    return Triangle(T=triangle[:-1, :-1], b=triangle[:-1, -1], rest=float(triangle[-1, -1] ** 2))


def stacked_triangle(blocks: Iterable[FloatArray]) -> FloatArray:
    """Return the upper triangle (P, P) of the QR factors of all rows of the `blocks` (..., P), a few rows at a time."""
    from scipy.linalg import lapack

    triangle: FloatArray | None = None
    for J in blocks:
        # The order of rows does not matter: where columns are contiguous nothing is copied.
        rows = J.reshape(-1, J.shape[-1], order="A")
        for first in range(0, max(len(rows), 1), BLOCK_ROWS):
            block = rows[first : first + BLOCK_ROWS]
            stacked = block if triangle is None else np.concatenate((triangle, block))
            triangle = np.triu(lapack.dgeqrf(stacked)[0][: stacked.shape[1]])
    if triangle is None:
        raise ValueError("least squares need at least one block")
    square = np.zeros((triangle.shape[1], triangle.shape[1]))
    square[: len(triangle)] = triangle
    return square


Problem = Callable[[FloatArray], Triangle]
"""Function that returns the triangle of residuals and Jacobian at given parameters (P,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Parameters `x` (P,) where the iteration ended, and the `cost`, half the sum of squared residuals.

    `converged`: whether the last step, or the reduction of the cost expected from it, was negligible. `triangle`:
    triangle at `x`. If the last step was too small to be evaluated, the Jacobian is that of the point before it.
    """

    x: FloatArray
    cost: float
    iterations: int
    converged: bool
    triangle: Triangle


def column_scale(J: FloatArray) -> FloatArray:
    """Return the divisors (P,) that scale the columns of J to norm 1; 1 for a column that is zero up to rounding."""
    norms = np.linalg.norm(J, axis=0)
    return np.where(norms > UNSEEN * norms.max(initial=0.0), norms, 1.0)


def solve_damped(
    problem: Problem, x0: FloatArray, *, max_iterations: int = 100, progress: Progress | None = None
) -> Fit:
    """Minimise the sum of squared residuals from `x0` (P,) until the steps are negligible.

    `problem` returns the `Triangle` of the residuals and their exact Jacobian at given parameters.
    """
    x = np.array(x0, dtype=np.float64)
    current, damping, iteration, last_cost = problem(x), 0.0, 0, 0.0

    def ended(x: FloatArray, *, converged: bool) -> Fit:
        return Fit(
            x=x, cost=current.cost, iterations=iteration, converged=converged, triangle=current
        )

    while iteration < max_iterations:
        while True:
            step, predicted = current.step(damping)
            largest = float(np.max(np.abs(step), initial=0.0))
            gain = predicted**2 / last_cost if last_cost > 0.0 else np.inf
            # Within rounding no step lowers the cost measurably: this is the minimum.
            if predicted <= LAST_SHARE * current.cost + 1e-300 or gain <= LEFT_SHARE * current.cost:
                if damping == 0.0:
                    x, current, iteration = x + step, current.after(step), iteration + 1
                return ended(x, converged=True)
            trial = problem(x + step)
            if np.isfinite(trial.cost) and trial.cost < current.cost:
                last_cost = predicted if damping == 0.0 else 0.0
                damping = 0.0 if damping < 1e-8 else damping / 10.0
                break
            last_cost = 0.0
            if largest < LEAST_STEP:
                return ended(x, converged=True)
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e12:
                return ended(x, converged=False)
        x, current, iteration = x + step, trial, iteration + 1
        if progress is not None:
            progress(iteration, current.cost)
        if largest < LEAST_STEP:
            return ended(x, converged=True)
    return ended(x, converged=False)

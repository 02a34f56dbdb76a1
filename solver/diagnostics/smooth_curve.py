"""Smooth curve through noisy points: Legendre terms chosen by leave-one-out prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray

MAX_DEGREE = 8

POINTS_PER_TERM = 4
"""Smallest number of points per term with which the prediction error is meaningful."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothCurve:
    """Legendre series over the covered range, fitted by least squares.

    `low`, `high`: covered range of the abscissa.
    `coefficients`: (degree + 1,).
    `smoother`: (degree + 1, m): maps the points to the coefficients.
    `residual`: (m,): points minus curve.
    `dof`: number of points minus number of coefficients.
    `line_probability`: probability of so much improvement over a straight line if the points lie on a straight line (F
    test, times the number of degrees that were compared); 1 if the curve is a straight line.
    """

    low: float
    high: float
    coefficients: FloatArray
    smoother: FloatArray
    residual: FloatArray
    dof: int
    line_probability: float

    @property
    def degree(self) -> int:
        """Selected degree; 1 is a straight line."""
        return len(self.coefficients) - 1

    def __call__(self, abscissa: FloatArray) -> FloatArray:
        """Value of the curve."""
        return np.asarray(_basis(abscissa, self.low, self.high, self.degree) @ self.coefficients)

    def by_points(self, abscissa: FloatArray) -> FloatArray:
        """Derivatives (k, m) of the curve at `abscissa` (k,) with respect to the points' values."""
        return np.asarray(_basis(abscissa, self.low, self.high, self.degree) @ self.smoother)


def fit_curve(abscissa: FloatArray, values: FloatArray, least_degree: int = 1) -> SmoothCurve:
    """Fit points (m,) with the degree, from `least_degree` up, whose leave-one-out error is smallest.

    A higher degree must improve on the best lower degree by more than the standard error of the improvement, so that
    noise is not fitted. The chosen curve as a whole is tested against a straight line. At least `2 * POINTS_PER_TERM`
    points, not all at one abscissa, are needed.
    """
    from scipy.special import fdtrc

    m = len(abscissa)
    low, high = float(abscissa.min()), float(abscissa.max())
    # Degrees are nested: each adds one direction to those of the degree below.
    most = min(MAX_DEGREE, m // POINTS_PER_TERM - 1)
    nested = _basis(abscissa, low, high, most)
    Q, R = np.linalg.qr(nested)
    residuals = values[:, None] - np.cumsum(Q * (Q.T @ values), axis=1)
    leverages = np.cumsum(Q**2, axis=1)
    left_out = (residuals / np.maximum(1.0 - leverages, 1e-12)) ** 2
    best = 1
    for degree in range(2, most + 1):
        gain = left_out[:, best] - left_out[:, degree]
        error = float(gain.std() * np.sqrt(m))
        if degree <= least_degree or float(gain.sum()) > error:
            best = degree
    smoother = np.asarray(np.linalg.solve(R[: best + 1, : best + 1], Q[:, : best + 1].T))
    dof = m - best - 1
    chance = 1.0
    if best > 1:
        more = best - 1
        line, curve = (float(residuals[:, degree] @ residuals[:, degree]) for degree in (1, best))
        ratio = (line - curve) / more / max(curve / dof, 1e-300)
        chance = min(1.0, (most - 1) * float(fdtrc(more, dof, ratio)))
    return SmoothCurve(
        low=low,
        high=high,
        coefficients=smoother @ values,
        smoother=smoother,
        residual=residuals[:, best],
        dof=dof,
        line_probability=chance,
    )


def _basis(abscissa: FloatArray, low: float, high: float, degree: int) -> FloatArray:
    """Legendre polynomials (..., degree + 1) at points of the range from `low` to `high`."""
    x = (2.0 * np.asarray(abscissa) - low - high) / (high - low)
    return np.asarray(np.polynomial.legendre.legvander(x, degree))

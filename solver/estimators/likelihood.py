"""Derivatives of the restricted likelihood of a mixed model with respect to its variances.

Restricted likelihood (Patterson & Thompson 1971) estimates variances from the part of the data that no parameter can
explain, so degrees of freedom are accounted for. Its derivatives need only the inverse of the mixed-model equations and
blocks of single poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from solver.arrays import FloatArray

if TYPE_CHECKING:
    from solver.estimators.linear_fit import LinearFit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Derivatives:
    """Gradient (K,), expected information and negative second derivative (K, K) of the likelihood.

    Twice the gradient is a quadratic form of the residuals minus its expectation, `expected` (K,).
    """

    score: FloatArray
    information: FloatArray
    curvature: FloatArray
    expected: FloatArray


def likelihood_derivatives(fit: LinearFit) -> Derivatives:
    """Differentiate the restricted log-likelihood with respect to every variance component, at `fit`."""
    design, K = fit.design, len(fit.v)
    hard, width = design.hard, design.width
    # Rates of the logarithm of each effect column's variance.
    rates = design.variance_rates / design.group_variances(fit.v)[:, None]
    # Effects: with T = Z' P Z = I - H^-1 in units of their variance, all traces are sums over its blocks.
    determined = 1.0 - np.diagonal(fit.H_inverse)[hard:]
    squares = fit.H_inverse[hard:, hard:] ** 2
    np.fill_diagonal(squares, determined**2)
    expected = determined @ rates
    score = fit.unit_b**2 @ rates - expected
    information = rates.T @ (squares @ rates)
    # The mean of expected and observed information needs no trace: it is a Gram matrix of each component's covariance
    # times the weighted residual (Gilmour, Thompson & Cullis 1995).
    inner, along = np.zeros((K, K)), np.zeros((K, width))
    effects = rates * fit.unit_b[:, None]
    # Noise: blocks of P on the diagonal, pose by pose.
    for part in fit.parts():
        m, r = part.w.shape
        M = part.M.reshape(m * r, width)
        X = M @ fit.H_inverse
        P = np.eye(r) - X.reshape(m, r, width) @ np.swapaxes(part.M, -1, -2)
        residual = (part.w + part.times(fit.coefficients))[..., None]
        # A component's derivative of the noise's covariance is C diag(rates) C'.
        own, noise = design.noise_rates(part.poses)
        C, rows = part.C, m * part.C.shape[-1]
        by_own = noise.reshape(rows, -1)
        Ct = np.swapaxes(C, -1, -2)
        pulled_residual = Ct @ residual
        pulled = -M[:, hard:] @ effects
        pulled[:, own] += (C @ (noise * pulled_residual)).reshape(m * r, -1)
        inner += pulled.T @ pulled
        along += pulled.T @ M
        PC = P @ C
        expected_part = (PC * C).sum(1).ravel() @ by_own
        expected[own] += expected_part
        score[own] += pulled_residual.ravel() ** 2 @ by_own - expected_part
        squared = (Ct @ PC) * (Ct @ C) @ noise
        information[np.ix_(own, own)] += by_own.T @ squared.reshape(rows, -1)
        # The projector P times the effects' columns of each pose, along the noise columns.
        effect_columns = (Ct @ X.reshape(m, r, width)[..., hard:]).reshape(rows, -1)
        across = (by_own.T @ effect_columns**2) @ rates
        information[own] += across
        information[:, own] += across.T
    average = inner - along @ fit.H_inverse @ along.T
    return Derivatives(
        score=0.5 * score,
        information=0.5 * information,
        curvature=average - 0.5 * information,
        expected=expected,
    )

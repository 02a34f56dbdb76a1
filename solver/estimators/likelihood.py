"""Derivatives of the restricted likelihood of a mixed model by its variances.

Restricted likelihood (Patterson & Thompson 1971) estimates variances from the part that no parameter can explain, so
degrees of freedom are accounted for. Its derivatives need the inverse of the mixed-model equations and per-pose blocks
only.
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
    """Differentiate the restricted log-likelihood by every component, at `fit`."""
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
        left = (part.w + part.times(fit.coefficients))[..., None]
        Q, component = design.noise_factors(part)
        # Sums over the columns of each component.
        of = (component[:, None] == np.arange(K)).astype(np.float64)
        Qt = np.swapaxes(Q, -1, -2)
        seen = Qt @ left
        pulled = (Q * seen[..., 0][:, None]).reshape(m * r, -1) @ of
        pulled -= M[:, hard:] @ effects
        inner += pulled.T @ pulled
        along += pulled.T @ M
        PQ = P @ Q
        chance = (PQ * Q).sum((0, 1)) @ of
        expected += chance
        score += (seen[..., 0] ** 2).sum(0) @ of - chance
        information += of.T @ ((Qt @ PQ) * (Qt @ Q)).sum(0) @ of
        # Squares of each effect's columns of a pose under P.
        reached = Qt @ X.reshape(m, r, width)[..., hard:]
        across = of.T @ np.einsum("mfc,mfc->fc", reached, reached) @ rates
        information += across + across.T
    average = inner - along @ fit.H_inverse @ along.T
    return Derivatives(
        score=0.5 * score,
        information=0.5 * information,
        curvature=average - 0.5 * information,
        expected=expected,
    )

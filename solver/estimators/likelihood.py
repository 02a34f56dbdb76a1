"""Derivatives of the restricted likelihood of a mixed model by its variances.

Restricted likelihood (Patterson & Thompson 1971) estimates variances from the part that no parameter can explain, so
degrees of freedom are accounted for. Its derivatives need the inverse of the mixed-model equations and per-pose blocks
only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.estimators.effects import LinearModel, Whitened


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Derivatives:
    """Gradient (K,), expected information and negative second derivative (K, K) of the likelihood.

    Twice the gradient is a quadratic form of the residuals minus its expectation, `expected` (K,).
    """

    score: FloatArray
    information: FloatArray
    curvature: FloatArray
    expected: FloatArray


class SolvedModel(Protocol):
    """A mixed model solved at the variances v (K,); `solver.estimators.linear_fit` defines each attribute."""

    design: LinearModel
    v: FloatArray
    coefficients: FloatArray
    unit_b: FloatArray

    @property
    def H_inverse(self) -> FloatArray:
        """Inverse of the mixed-model equations (width, width)."""
        ...

    def parts(self) -> Iterator[Whitened]:
        """Whitened poses, effects scaled to unit variance."""
        ...


def likelihood_derivatives(fit: SolvedModel) -> Derivatives:
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
        of = _indicator(component, K)
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
        # # Squares of each effect's columns of a pose under P.
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


def _indicator(component: IntArray, K: int) -> FloatArray:
    """Matrix (f, K) of ones and zeros that sums over the columns of each component."""
    return np.asarray(component[:, None] == np.arange(K), dtype=np.float64)

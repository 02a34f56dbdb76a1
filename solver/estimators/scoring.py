"""Derivatives of the restricted likelihood of a mixed model, and one scoring step of its variances.

Restricted likelihood (Patterson & Thompson 1971) estimates variances from the part of the data that no parameter can
explain, so degrees of freedom are accounted for. Its derivatives need only the inverse of the mixed-model equations and
each pose's block of the projector. The scale of a source of error is the ratio of its magnitude to the one expected
from the files. It has a log-normal prior of median 1 (method, section 10, "Scales").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from solver.arrays import FloatArray
from solver.estimators.layout import LENGTHS, PLACEMENT, TWISTS, Layout

if TYPE_CHECKING:
    from solver.estimators.linear_fit import LinearFit

TINY = 1e-300
"""Lower limit of a logarithm's argument."""

AT_BOUND = 1e-9
"""A variance counts as at its bound if it differs from the bound by no more than this share of the bound."""

LARGEST_VARIANCE_RATIO = 6.0
"""Largest factor by which a variance changes in one step."""

OVERSHOOT_SHARE = 0.5
"""A step has overshot if the slope at its end is below minus this share of the slope at its start."""

LEAST_SHARE = 0.1
"""A step that was shortened to less than this share of Newton's step is not shortened further."""

LIKELIHOOD_FALL = 3.0
"""Largest fall of the log-likelihood that a new linearisation can explain; after a larger one the step is shortened."""

NEWTON_SIGMA = 1.0
"""Largest step, in standard errors, for which the observed curvature is used (Newton) rather than the expected."""

LEAST_CURVATURE = 0.05
"""Newton's step is used only if all eigenvalues of the curvature, relative to the expected information, exceed this."""

SCALE_SD = float(np.log(2.0))
"""Standard deviation of the logarithm of a source's scale (ratio to the stated one): a factor of two is one sigma."""

SCALE_CORRELATION = 0.5
"""Correlation of the logarithms of two scales of one group (`_scale_groups`): if a file states one error larger than it
is, it usually does so for all. So scales that the poses hardly determine follow the other scales of the group."""

LARGEST_COMMON = 3.0 * SCALE_SD
"""Limit of the magnitude of a scale's logarithm in its effect on the other scales of the group: an error below 1/8 of
its stated size counts as absent, which implies nothing more about the others."""

FAST_SHARE = 0.45
"""Convergence is fast if a step is below this share of the step before."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Derivatives:
    """Derivatives of the log-likelihood with respect to the K variance components.

    `score` (K,): gradient. `information`, `curvature` (K, K): expected and observed negative second derivative.
    `expected` (K,): expectation of a weighted sum of squared residuals and effects. Without priors, ``2 score`` is this
    sum minus its expectation.
    """

    score: FloatArray
    information: FloatArray
    curvature: FloatArray
    expected: FloatArray


def likelihood_derivatives(fit: LinearFit) -> Derivatives:
    """Differentiate the restricted log-likelihood with respect to every variance component, at `fit`."""
    design, K = fit.design, len(fit.v)
    flat, width = design.flat_count, design.width
    # Rates of the logarithm of each effect column's variance.
    rates = design.variance_rates / design.group_variances(fit.v)[:, None]
    # Effects: with T = Z' P Z = I - H^-1 in units of their variance, all traces are sums over its blocks.
    determined = 1.0 - np.diagonal(fit.H_inverse)[flat:]
    squares = fit.H_inverse[flat:, flat:] ** 2
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
        X, P = fit.leverage(part)
        # A component's derivative of the noise's covariance is C diag(rates) C'.
        sources = design.noise_sources(part.poses)
        own, noise = sources.estimated, sources.derivatives
        C, rows = part.C, m * part.C.shape[-1]
        by_own = noise.reshape(rows, -1)
        Ct = np.swapaxes(C, -1, -2)
        pulled_residual = Ct @ fit.residual(part)[..., None]
        pulled = -M[:, flat:] @ effects
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
        effect_squares = (Ct @ X[..., flat:]).reshape(rows, -1)
        effect_squares *= effect_squares
        across = (by_own.T @ effect_squares) @ rates
        information[own] += across
        information[:, own] += across.T
    average = inner - along @ fit.H_inverse @ along.T
    return Derivatives(
        score=0.5 * score,
        information=0.5 * information,
        curvature=average - 0.5 * information,
        expected=expected,
    )


def with_priors(fit: LinearFit) -> Derivatives:
    """Return the derivatives, at `fit`, of the log-likelihood plus the logarithm of the variances' priors."""
    v, derivatives = fit.v, fit.derivatives
    dof, spread, scale = np.array(
        [(c.spread_dof, c.spread_variance, c.prior_scale) for c in fit.design.components]
    ).T.reshape(3, -1)
    ratio = spread / v
    # Derivatives by v of the prior of t = log(v / start) / 2.
    t = 0.5 * np.log(v / fit.design.start_variances())
    slope, precision, bend = _scale_prior(fit.design, t)
    pull, of_scales = 0.5 * slope / v, 0.25 * precision / np.outer(v, v)
    return replace(
        derivatives,
        score=derivatives.score + 0.5 * (dof * (ratio - 1.0) / v - 1.0 / scale) - pull,
        information=derivatives.information + of_scales + np.diag(0.5 * dof / v**2),
        curvature=derivatives.curvature
        + of_scales
        + np.diag(dof * (ratio - 0.5) / v**2 - pull / v + 0.25 * bend / v**2),
    )


def _scale_prior(design: Layout, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Differentiate minus the logarithm of the prior density of the scales' logarithms `t` (K,).

    Returns the gradient (K,), then two parts of the second derivative: a positive semidefinite matrix (K, K), and the
    diagonal (K,) of the rest. With ``g = L tanh(t / L)`` and L = `LARGEST_COMMON`, the differentiated function is
    ``(sum t^2 / own - sum_groups shared (sum g)^2) / (2 SCALE_SD^2)``: the first sum is over all scales, the last over
    those of a group. The constants `own` of a scale and `shared` of a group are such that, for small t, the prior is
    normal with the standard deviation `SCALE_SD` and, within a group, the correlation `SCALE_CORRELATION`.
    """
    scaled, groups = design.scaled.astype(float), _scale_groups(design)
    own = 1.0 - SCALE_CORRELATION * groups.sum(axis=0)
    others = SCALE_CORRELATION * (groups.sum(axis=1) - 1.0)
    shared = SCALE_CORRELATION / ((1.0 + others) * (1.0 - SCALE_CORRELATION))
    g = LARGEST_COMMON * np.tanh(t / LARGEST_COMMON)
    rate = 1.0 - (g / LARGEST_COMMON) ** 2
    pulled = groups.T @ (shared * (groups @ g))
    rates = groups * rate
    return (
        (scaled * t / own - pulled * rate) / SCALE_SD**2,
        np.asarray((np.diag(scaled / own) - (rates.T * shared) @ rates) / SCALE_SD**2),
        2.0 * pulled * g * rate / (LARGEST_COMMON * SCALE_SD) ** 2,
    )


def _scale_groups(design: Layout) -> FloatArray:
    """Return masks (groups, K) of 0 and 1, one for each group of scales whose priors are correlated.

    One group is the lengths and twists of the maker's table. The other is the errors of joints and sensors and the
    fixture's deflection, which imply nothing about the table. The fixture's placement is in neither group.
    """
    names = np.array(list(design.index), dtype=str)
    of_links = np.isin(names, (LENGTHS, TWISTS))
    moving = design.scaled & ~of_links & (names != PLACEMENT)
    groups = np.stack((of_links, moving)).astype(float)
    # A group of one scale has no correlation.
    return np.asarray(groups[groups.sum(axis=1) > 1.0])


def scale_spread(fit: LinearFit, derivatives: Derivatives) -> FloatArray:
    """Return the posterior variance (K,) of each scale's logarithm; 0 for components without a log-normal prior."""
    scaled = fit.design.scaled
    spread = np.zeros(len(scaled))
    if scaled.any():
        v = fit.v[scaled]
        information = 4.0 * np.outer(v, v) * derivatives.information[np.ix_(scaled, scaled)]
        spread[scaled] = np.clip(np.diagonal(np.linalg.inv(information)), 0.0, SCALE_SD**2)
    return spread


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScoringStep:
    """Newton's step of the K variances.

    `change` (K,): change of the variances, within their bounds. `largest`: largest change, in standard errors.
    `slope`: gradient of the log-likelihood times the step. The step raises the log-likelihood by about half the slope.
    """

    change: FloatArray
    largest: float
    slope: float

    @classmethod
    def none(cls, components: int) -> ScoringStep:
        """Return the zero step."""
        return cls(change=np.zeros(components), largest=0.0, slope=0.0)


def step(fit: LinearFit, derivatives: Derivatives) -> ScoringStep:
    """Return Newton's step of the variances; a variance that would leave its bounds stops at the bound.

    For a variance v with a log-normal prior, the step is calculated in ``t = log(v) / 2``, in which the log-likelihood
    is most nearly quadratic.
    """
    v, floor, scaled = fit.v, fit.design.floors, fit.design.scaled
    ceiling, raise_limit = fit.design.ceilings, fit.design.raise_limits
    low = np.where(raise_limit > 0.0, floor, np.maximum(floor, v / LARGEST_VARIANCE_RATIO))
    high = np.minimum(ceiling, np.maximum(LARGEST_VARIANCE_RATIO * v, raise_limit))
    rate = np.where(scaled, 2.0 * v, 1.0)
    known = np.diagonal(derivatives.information) * rate**2
    # Components without information (by rounding even below zero) do not change.
    determined = known > 0.0
    size = np.sqrt(np.where(determined, known, 1.0))
    unit = rate / size
    score = derivatives.score * unit
    # A step to a bound may miss it by a rounding error.
    above, below = v > floor * (1.0 + AT_BOUND), v < ceiling * (1.0 - AT_BOUND)
    moving = determined & (above | (score > 0.0)) & (below | (score < 0.0))

    def changed(change: FloatArray) -> FloatArray:
        """Return the variances (K,) after `change` (K,), which is in units of their standard errors."""
        grown = v * np.exp(np.clip(2.0 * change / size, -50.0, 50.0))
        return np.where(scaled, grown, v + change / size)

    def to(bound: FloatArray) -> FloatArray:
        """Return the change (K,), in standard errors, with which each variance reaches `bound` (K,)."""
        return np.where(scaled, 0.5 * np.log(np.maximum(bound, TINY) / v), bound - v) * size

    def bounded(metric: FloatArray) -> FloatArray:
        """Return the step (K,) with ``metric @ change = score``; a variance that would leave its bounds stops there."""
        change, free = np.zeros(len(v)), moving.copy()
        ridged = metric + 1e-9 * np.eye(len(v))
        while free.any():
            change[free] = 0.0
            target = score - metric @ change
            change[free] = np.linalg.solve(ridged[free][:, free], target[free])
            then = changed(change)
            below, above = free & (then < low), free & (then > high)
            if not (below | above).any():
                break
            change[below], change[above] = to(low)[below], to(high)[above]
            free &= ~below & ~above
        return change

    change = bounded(derivatives.information * np.outer(unit, unit))
    if np.abs(change).max(initial=0.0) < NEWTON_SIGMA and moving.any():
        # Far from the maximum the observed curvature may be wrong; there the expected one converges fast.
        bend = np.diag(np.where(scaled, 4.0 * v * derivatives.score, 0.0) / size**2)
        metric = derivatives.curvature * np.outer(unit, unit) - bend
        if np.linalg.eigvalsh(metric[np.ix_(moving, moving)])[0] > LEAST_CURVATURE:
            change = bounded(metric)
    return ScoringStep(
        change=np.clip(changed(change), low, high) - v,
        largest=float(np.abs(change).max(initial=0.0)),
        slope=float(score @ change),
    )


class VarianceSearch:
    """Search for the variances of maximum likelihood by Newton's steps, which are shortened where they overshoot.

    If a variance leaves its floor, the curvature changes quickly, and full steps may oscillate forever. If the slope of
    the likelihood at a step's end shows an overshoot, the next iteration starts at the maximum along this step.

    `fast`: whether steps shrink so fast that further steps are negligible; at first, the argument's value.
    `slope_left`: slope (see `ScoringStep`) that is expected of the step after the last one.
    """

    def __init__(self, *, fast: bool = False) -> None:
        self.fast, self.slope_left = fast, np.inf
        self._from: tuple[FloatArray, float, ScoringStep] | None = None
        self._share = 1.0
        self._last_size: float | None = None

    def next_variances(
        self, fit: LinearFit, derivatives: Derivatives, newton_step: ScoringStep, *, far: bool
    ) -> FloatArray:
        """Return the variances (K,) for the next iteration; `newton_step`: Newton's step from the variances of `fit`.

        `far`: whether the parameters change so much that likelihoods before and after the step cannot be compared.
        """
        size, last_size = newton_step.largest, self._last_size
        self.slope_left, self._last_size = newton_step.slope, size
        if last_size is not None:
            self.fast = size < FAST_SHARE * last_size
        if self._from is not None:
            start, likelihood, last = self._from
            slope = float(derivatives.score @ last.change)
            fell = fit.log_likelihood < likelihood - LIKELIHOOD_FALL
            if self._share > LEAST_SHARE and (slope < -OVERSHOOT_SHARE * last.slope or fell):
                top = last.slope / (last.slope - slope) if slope < 0.0 else 0.5
                self._share *= float(np.clip(top, 0.1, 0.7))
                return np.asarray(start + self._share * last.change)
            # Where one step overshot, the next would as well.
            self._share = min(1.0, 2.0 * self._share)
        if last_size is not None and self.fast and self._share == 1.0:
            # The next step shrinks by the factor by which this one did, and its slope by the square.
            self.slope_left *= (size / last_size) ** 2
        self._from = None if far else (fit.v, fit.log_likelihood, newton_step)
        return np.asarray(fit.v + self._share * newton_step.change)

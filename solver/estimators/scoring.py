"""One scoring step of the variances of a mixed model, by restricted maximum likelihood. Knows no loop.

Restricted likelihood (Patterson & Thompson 1971) judges variances by what no parameter can explain,
so degrees of freedom are accounted for. Its gradient needs the inverse of the mixed-model equations
and per-pose blocks only. A variance never falls below its floor, which is what the files state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.estimators.linear_fit import LinearFit

FASTEST = 6.0
"""A variance changes by no more than this factor in one step."""

PAST = 0.5
"""A step whose end falls off by this share of the slope at its start went past the top."""

LEAST_SHARE = 0.1
"""Where so little of a step is left it was no good: the next is made from there."""

WORSE = 3.0
"""Fall of the log-likelihood in a round that relinearising does not explain."""

NEAR = 0.3
"""Change in standard errors up to which the likelihood is taken for its parabola."""

CONCAVE = 0.05
"""Smallest eigenvalue of the curvature, in units of the expected information, for Newton's step."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Derivatives:
    """Gradient (K,), expected information and negative second derivative (K, K) of the likelihood.

    Twice the gradient is a square of the residuals less what chance makes of it, `expected` (K,).
    """

    score: FloatArray
    information: FloatArray
    curvature: FloatArray
    expected: FloatArray


def derivatives(fit: LinearFit, *, priors: bool = True) -> Derivatives:
    """Differentiate the restricted log-likelihood by every component, at `fit`.

    `priors` counts what a specification says of an amplitude, and spreads recorded inside poses.
    """
    design, v = fit.design, fit.v
    K, hard, width = len(v), design.hard, design.width
    score, information, expected = np.zeros(K), np.zeros((K, K)), np.zeros(K)
    if K == 0:
        return Derivatives(
            score=score, information=information, curvature=information, expected=expected
        )
    # Effects: with T = Z' P Z in units of their variance, all traces are sums over its blocks.
    T = np.eye(width - hard) - fit.H_inverse[hard:, hard:]
    groups = [
        (g, slice(s.start - hard, s.stop - hard), (g.scale / g.variance(v)))
        for g, s in zip(design.groups, design.slices, strict=True)
    ]
    moving = [(g.component, where, rate) for g, where, rate in groups if g.component is not None]
    square = T * T
    for c, where, rate in moving:
        b = fit.unit_b[where]
        chance = rate * float(np.trace(T[where, where]))
        expected[c] += chance
        score[c] += 0.5 * (rate * float(b @ b) - chance)
        for d, other, rate2 in moving:
            information[c, d] += 0.5 * rate * rate2 * float(square[where, other].sum())
    # The mean of expected and observed information needs no trace: it is a Gram matrix of what each
    # component's covariance makes of the weighted residual (Gilmour, Thompson & Cullis 1995).
    inner, along = np.zeros((K, K)), np.zeros((K, width))
    # Noise: blocks of P on the diagonal, pose by pose.
    for part in fit.parts():
        m, r = part.w.shape
        M = part.M.reshape(m * r, width)
        X = M @ fit.H_inverse
        P = np.eye(r) - X.reshape(m, r, width) @ np.swapaxes(part.M, -1, -2)
        left = (part.w + part.M @ fit.coefficients)[..., None]
        blocks = list(design.noise_blocks(part))
        pulled = np.zeros((K, m * r))
        for c, C in blocks:
            pulled[c] += (C @ left).reshape(-1)
        for c, where, rate in moving:
            inside = slice(where.start + hard, where.stop + hard)
            pulled[c] -= rate * (M[:, inside] @ fit.unit_b[where])
        inner += pulled @ pulled.T
        along += pulled @ M
        # Squares of what each effect's columns leave of a pose under P.
        columns = X.reshape(m, r, width)[..., hard:]
        spread: dict[int, FloatArray] = {}
        for e, where, rate in moving if blocks else ():
            Y = columns[..., where]
            YY = rate * (Y @ np.swapaxes(Y, -1, -2))
            spread[e] = spread[e] + YY if e in spread else YY
        for c, C in blocks:
            chance = float((P * C).sum())
            expected[c] += chance
            score[c] += 0.5 * (float((left * (C @ left)).sum()) - chance)
            PC = P @ C
            for d, D in blocks:
                information[c, d] += 0.5 * float((PC * np.swapaxes(D, -1, -2)).sum())
            for e, YY in spread.items():
                value = 0.5 * float((YY * C).sum())
                information[c, e] += value
                information[e, c] += value
    average = 0.5 * (inner - along @ fit.H_inverse @ along.T)
    curvature = 2.0 * average - information
    if priors:
        for k, component in enumerate(design.components):
            if component.spread_dof:
                ratio = component.spread_variance / v[k]
                score[k] += 0.5 * component.spread_dof * (ratio - 1.0) / v[k]
                information[k, k] += 0.5 * component.spread_dof / v[k] ** 2
                curvature[k, k] += component.spread_dof * (ratio - 0.5) / v[k] ** 2
            score[k] -= 0.5 / component.soft
    return Derivatives(score=score, information=information, curvature=curvature, expected=expected)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """From variances to what they should be.

    Attributes
    ----------
    change
        (K,); no variance leaves its bounds by it.
    largest
        Largest change in standard errors.
    slope
        Rise of the log-likelihood along all of it at its start; about twice what there is to gain.
    """

    change: FloatArray
    largest: float
    slope: float

    @classmethod
    def none(cls, components: int) -> Step:
        """Return the step of variances that stay."""
        return cls(change=np.zeros(components), largest=0.0, slope=0.0)


def step(fit: LinearFit, found: Derivatives) -> Step:
    """Newton's step of the variances, those at a bound that they would leave held there."""
    v = fit.v
    floor = np.array([c.floor for c in fit.design.components])
    wall = np.array([c.wall for c in fit.design.components])
    leap = np.array([c.leap for c in fit.design.components])
    low = np.where(leap > 0.0, floor, np.maximum(floor, v / FASTEST))
    high = np.minimum(wall, np.maximum(FASTEST * v, leap))
    size = np.sqrt(np.maximum(np.diagonal(found.information), 1e-300))
    score, moving = found.score / size, (v > floor) | (found.score > 0.0)
    moving &= (v < wall) | (score < 0.0)

    def bounded(metric: FloatArray) -> FloatArray:
        """Solve for the change; what would leave its bounds goes to them, and the others step as is then best."""
        change, free = np.zeros(len(v)), moving.copy()
        while free.any():
            target = score[free] - metric[np.ix_(free, ~free)] @ change[~free]
            block = metric[np.ix_(free, free)] + 1e-9 * np.eye(int(free.sum()))
            change[free] = np.linalg.solve(block, target)
            below = free & (v + change / size < low)
            above = free & (v + change / size > high)
            if not (below | above).any():
                break
            change[below] = ((low - v) * size)[below]
            change[above] = ((high - v) * size)[above]
            free &= ~below & ~above
        return change

    change = bounded(found.information / np.outer(size, size))
    if np.abs(change).max(initial=0.0) < NEAR and moving.any():
        # Away from the maximum the curvature may point anywhere, and its expectation leads there fast.
        metric = found.curvature / np.outer(size, size)
        if np.linalg.eigvalsh(metric[np.ix_(moving, moving)])[0] > CONCAVE:
            change = bounded(metric)
    return Step(
        change=np.clip(v + change / size, low, high) - v,
        largest=float(np.abs(change).max(initial=0.0)),
        slope=float(score @ change),
    )


class Ascent:
    """The way up the likelihood: Newton's steps, each taken back in part where it went past the top.

    Where a variance comes off its floor the likelihood bends more than its curvature there says, and
    steps alone may go to and fro for ever. The slope at a step's end, known anyway, tells where along
    the step the top was, so nothing is computed twice: the next round is made there.
    """

    def __init__(self) -> None:
        self._from: tuple[FloatArray, float, Step] | None = None
        self._share = 1.0

    def onward(self, fit: LinearFit, found: Derivatives, wanted: Step, *, far: bool) -> FloatArray:
        """Variances (K,) for the next round, `wanted` being Newton's step from those of `fit`.

        `far` says that the next linearisation will be so different that slopes cannot be compared.
        """
        if self._from is not None:
            start, likelihood, last = self._from
            slope = float(found.score @ last.change)
            fell = fit.log_likelihood < likelihood - WORSE
            if self._share > LEAST_SHARE and (slope < -PAST * last.slope or fell):
                top = last.slope / (last.slope - slope) if slope < 0.0 else 0.5
                self._share *= float(np.clip(top, 0.1, 0.7))
                return np.asarray(start + self._share * last.change)
            # Where one step went too far the next would as well.
            self._share = min(1.0, 2.0 * self._share)
        self._from = None if far else (fit.v, fit.log_likelihood, wanted)
        return np.asarray(fit.v + self._share * wanted.change)

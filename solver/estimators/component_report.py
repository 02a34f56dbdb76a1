"""Variance components as an operator reads them: standard deviations, intervals, the flexure test.

Knows what a restricted likelihood returns; no loop and no fixture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.estimators.reml import RemlFit, Solution

FLEXURE_LEVEL = 0.01
"""The fixture is taken to be rigid unless the data would look like this less often."""

TWO_SIDED = 1.959963984540054
"""Standard normal deviate of a two-sided 95 % interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """Standard deviation of one source of error.

    Attributes
    ----------
    name
        ``rvdt_6``, ``curve_6``, ``fixture_m``, ``fixture_rad``.
    unit
        ``rad`` or ``m``.
    sd, low, high
        Value and 95 % interval. A component that the data do not show is 0 with `low` 0.
    """

    name: str
    unit: str
    sd: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FlexureTest:
    """Likelihood-ratio test of a rigid fixture against one that gives.

    Attributes
    ----------
    statistic
        Twice the gain in restricted log-likelihood.
    p_value
        Under the mixture of chi-squares that holds on the boundary of variances >= 0.
    gives
        Whether the data ask for a flexure at `FLEXURE_LEVEL`.
    """

    statistic: float
    p_value: float
    gives: bool


def components(
    fit: RemlFit,
    labels: tuple[str, ...],
    *,
    held: BoolArray,
    floor: FloatArray,
    to_sd: FloatArray,
) -> tuple[Component, ...]:
    """Report every component that was not held.

    The interval is Satterthwaite's: a variance estimate with standard error s is distributed as
    chi2 with 2 v^2 / s^2 degrees of freedom, exactly so when it stands alone.

    Parameters
    ----------
    floor
        Known part of each variance (K,), added to the estimate.
    to_sd
        Factor (K,) from the root of the variance to what is reported.
    """
    error = _standard_errors(fit.solution.information, fit.variances, held)
    found = []
    for k in np.flatnonzero(~held):
        low, high = _interval(float(fit.variances[k]), float(error[k]))
        sizes = np.sqrt(np.array([fit.variances[k], low, high]) + floor[k]) * to_sd[k]
        at_zero = fit.variances[k] == 0.0
        found.append(
            Component(
                name=labels[k],
                unit="m" if labels[k].endswith("_m") else "rad",
                sd=0.0 if at_zero else float(sizes[0]),
                low=0.0 if at_zero else float(sizes[1]),
                high=float(sizes[2]),
            )
        )
    return tuple(found)


def flexure_test(rigid: Solution, giving: Solution, slots: BoolArray) -> FlexureTest:
    """Test the components `slots` (K,) for zero.

    On the boundary the statistic is a mixture of chi2 with 0, 1 and 2 degrees of freedom (Self &
    Liang 1987), with weights from the angle between the two components in the metric of their
    information, the other components being estimated as well.
    """
    from scipy.special import chdtrc

    statistic = max(0.0, 2.0 * (giving.log_likelihood - rigid.log_likelihood))
    weights = _mixture(rigid.information, slots)
    if statistic == 0.0:
        p_value = 1.0
    else:
        p_value = float(
            sum(w * chdtrc(degrees, statistic) for degrees, w in enumerate(weights) if degrees)
        )
    return FlexureTest(statistic=statistic, p_value=p_value, gives=p_value < FLEXURE_LEVEL)


def _mixture(information: FloatArray, slots: BoolArray) -> tuple[float, ...]:
    inside, outside = np.flatnonzero(slots), np.flatnonzero(~slots)
    block = information[np.ix_(inside, inside)]
    if len(outside):
        cross = information[np.ix_(inside, outside)]
        rest = information[np.ix_(outside, outside)]
        size = np.sqrt(np.maximum(np.diagonal(rest), 1e-300))
        inverse = np.linalg.pinv(rest / np.outer(size, size), rcond=1e-12) / np.outer(size, size)
        block = block - cross @ inverse @ cross.T
    if len(inside) == 1:
        return (0.5, 0.5)
    cosine = block[0, 1] / np.sqrt(block[0, 0] * block[1, 1])
    share = float(np.arccos(np.clip(cosine, -1.0, 1.0)) / (2.0 * np.pi))
    return (0.5 - share, 0.5, share)


def _standard_errors(information: FloatArray, variances: FloatArray, held: BoolArray) -> FloatArray:
    """Standard errors (K,); a component at zero does not blur the others and takes their blur."""
    inner = np.flatnonzero(~held & (variances > 0.0))
    error = np.zeros(len(variances))
    for k in np.flatnonzero(~held):
        use = inner if k in inner else np.append(inner, k)
        block = information[np.ix_(use, use)]
        size = np.sqrt(np.maximum(np.diagonal(block), 1e-300))
        inverse = np.linalg.pinv(block / np.outer(size, size), rcond=1e-12)
        error[k] = np.sqrt(np.diagonal(inverse)[list(use).index(k)]) / size[list(use).index(k)]
    return error


def _interval(variance: float, error: float) -> tuple[float, float]:
    from scipy.special import chdtri

    if variance == 0.0:
        return 0.0, TWO_SIDED * error
    degrees = 2.0 * (variance / error) ** 2
    if degrees < 1.0:
        # Hardly there at all: the lower end is zero, and chi2's upper end would run off to infinity.
        return 0.0, variance + TWO_SIDED * error
    # chdtri takes the probability above.
    low, high = chdtri(degrees, (0.025, 0.975))
    return float(degrees * variance / low), float(degrees * variance / high)

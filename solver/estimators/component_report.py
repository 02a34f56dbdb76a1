"""Variance components as an operator reads them: standard deviations, intervals, the flexure test.

Knows the mixed model's components; no loop and no fixture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.sensors import rms_per_amplitude
from solver.estimators.effects import LinearModel
from solver.estimators.linear_fit import LinearFit
from solver.estimators.mixed_fit import MixedFit

COMPLIANCE_LEVEL = 0.01
"""The fixture is taken to give as stated unless the data would look like this less often."""

TWO_SIDED = 1.959963984540054
"""Standard normal deviate of a two-sided 95 % interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """Standard deviation of one source of error.

    Attributes
    ----------
    name
        ``rvdt_6`` (of one single reading), ``curve_6``, ``fixture_m``, ``fixture_rad``.
    unit
        ``rad`` or ``m``.
    sd, low, high
        Value and 95 % interval.
    stated
        What the files state.
    """

    name: str
    unit: str
    sd: float
    low: float
    high: float
    stated: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceTest:
    """Score test of a fixture that gives as stated against one that gives more.

    Attributes
    ----------
    statistic
        Square of the score in its standard deviations; 0 where the data ask for less.
    p_value
        Chance of so large a statistic where the statement holds.
    gives
        Whether the data ask for more at `COMPLIANCE_LEVEL`.
    """

    statistic: float
    p_value: float
    gives: bool


LEAST_LEFT = 1e-12
"""Share of what is known of a variance below which the others' blur leaves nothing of it."""

MOST_CERTAIN = 1e6
"""No standard deviation is known better than to this share of itself."""


def components(found: MixedFit, design: LinearModel) -> tuple[Component, ...]:
    """Report noise and curve of every analogue sensor and the fixture's noise."""
    v, out = found.fit.v, []
    stated = design.stated_variances()
    error = standard_errors(found.derivatives().information, v, design.floors)
    for k, c in enumerate(design.components):
        kind = c.name.split("_")[0]
        if kind not in ("rvdt", "curve", "fixture"):
            continue
        to_sd = rms_per_amplitude() if kind == "curve" else 1.0
        low, high = interval(float(v[k]), float(error[k]))
        sizes = np.sqrt([v[k], low, high]) * to_sd
        out.append(
            Component(
                name=c.name,
                unit="m" if c.name.endswith("_m") else "rad",
                sd=float(sizes[0]),
                low=float(sizes[1]),
                high=float(sizes[2]),
                stated=float(np.sqrt(stated[k]) * to_sd),
            )
        )
    return tuple(out)


def compliance_test(stated: LinearFit, design: LinearModel) -> ComplianceTest | None:
    """Test at the stated variances whether the fixture's noise is larger, one component at a time."""
    from scipy.special import ndtr

    slots = list(design.fixture_components.values())
    if not slots:
        return None
    found = stated.derivatives
    z = found.score[slots] / np.sqrt(np.diagonal(found.information)[slots])
    statistic = float(np.maximum(z, 0.0).max() ** 2)
    p_value = min(1.0, len(slots) * float(ndtr(-np.sqrt(statistic))))
    return ComplianceTest(statistic=statistic, p_value=p_value, gives=p_value < COMPLIANCE_LEVEL)


def standard_errors(information: FloatArray, v: FloatArray, floor: FloatArray) -> FloatArray:
    """Standard errors (K,); a component at its floor does not blur the others and takes their blur."""
    inner = v > floor * (1.0 + 1e-9)
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = information / np.outer(size, size)
    inverse = np.linalg.pinv(scaled[np.ix_(inner, inner)], rcond=1e-12)
    across = scaled[np.ix_(~inner, inner)]
    own = np.empty(len(v))
    own[inner] = np.diagonal(inverse)
    # What the inner ones leave of what is known of each of the others (Schur).
    left = 1.0 - ((across @ inverse) * across).sum(-1)
    own[~inner] = np.where(left > LEAST_LEFT, 1.0 / np.maximum(left, LEAST_LEFT), 0.0)
    # A variance that a few poses leave to rounding has no error that could be told.
    return np.where(own > 0.0, np.sqrt(np.maximum(own, 0.0)), np.inf) / size


def interval(variance: float, error: float) -> tuple[float, float]:
    """95 % interval of a variance with standard error `error`, Satterthwaite's.

    It is distributed as chi2 with 2 v^2 / s^2 degrees of freedom, exactly so when it stands alone.
    """
    from scipy.special import chdtri

    degrees = 2.0 * min(variance / max(error, 1e-300), MOST_CERTAIN) ** 2
    if degrees < 1.0:
        # Hardly there at all: the lower end is zero, and chi2's upper end would run off to infinity.
        return 0.0, variance + TWO_SIDED * error
    # chdtri takes the probability above.
    low, high = chdtri(degrees, (0.025, 0.975))
    return float(degrees * variance / low), float(degrees * variance / high)

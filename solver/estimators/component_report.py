"""Reports variance components as standard deviations with intervals, and tests the fixture's compliance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.sensors import rms_per_amplitude
from solver.estimators.effects import LinearModel
from solver.estimators.layout import FIXTURE_NOISE
from solver.estimators.linear_fit import LinearFit

COMPLIANCE_LEVEL = 0.01
"""p-value below which the fixture counts as more compliant than stated."""

NORMAL_95 = 1.959963984540054
"""Standard normal deviate of a two-sided 95 % interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """Standard deviation `sd` of one source of error, with its 95 % interval, and the value `stated` in the files.

    `name`: ``rvdt_6`` (noise of a single reading), ``curve_6``, ``fixture_m``, ``fixture_rad``. `unit`: ``rad`` or
    ``m``.
    """

    name: str
    unit: str
    sd: float
    low: float
    high: float
    stated: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceTest:
    """Score test of a fixture's stated compliance against a larger one.

    `statistic`: square of the largest ratio of a score to its standard deviation; 0 if the data show a smaller
    compliance. `p_value`: probability of so large a statistic if the stated value is right. `deflects`: whether the
    data show a larger compliance at `COMPLIANCE_LEVEL`.
    """

    statistic: float
    p_value: float
    deflects: bool


LEAST_LEFT = 1e-12
"""Share of a variance's information that is left if the other variances are estimated too; less is due to rounding."""

MOST_CERTAIN = 1e6
"""Largest ratio of a variance to its standard error that `interval` uses."""


def components(design: LinearModel, v: FloatArray, error: FloatArray) -> tuple[Component, ...]:
    """Report noise and linearity of RVDTs, and fixture noise, from variances `v` and standard errors `error` (K,)."""
    out = []
    for k, c in enumerate(design.components):
        kind = c.name.split("_")[0]
        if kind not in ("rvdt", "curve", "fixture"):
            continue
        to_sd = rms_per_amplitude() if kind == "curve" else 1.0
        variances = (v[k], *interval(float(v[k]), float(error[k])), c.stated)
        sd, low, high, stated = (np.sqrt(variances) * to_sd).tolist()
        unit = "m" if c.name.endswith("_m") else "rad"
        out.append(Component(name=c.name, unit=unit, sd=sd, low=low, high=high, stated=stated))
    return tuple(out)


def compliance_test(stated: LinearFit, design: LinearModel) -> ComplianceTest | None:
    """Test whether a component of the fixture's noise is larger than stated; None if there is no such component."""
    from scipy.special import ndtr

    slots = [design.index[name] for name in FIXTURE_NOISE if name in design.index]
    if not slots:
        return None
    derivatives = stated.derivatives
    z = derivatives.score[slots] / np.sqrt(np.diagonal(derivatives.information)[slots])
    statistic = float(np.maximum(z, 0.0).max() ** 2)
    p_value = min(1.0, len(slots) * float(ndtr(-np.sqrt(statistic))))
    return ComplianceTest(statistic=statistic, p_value=p_value, deflects=p_value < COMPLIANCE_LEVEL)


def standard_errors(information: FloatArray, v: FloatArray, floor: FloatArray) -> FloatArray:
    """Standard errors (K,) of variances `v` (K,), from the likelihood's `information` (K, K).

    For the other variances' errors, a variance at its floor counts as known; its own error includes their uncertainty.
    """
    inner = v > floor * (1.0 + 1e-9)
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = information / np.outer(size, size)
    inverse = np.linalg.pinv(scaled[np.ix_(inner, inner)], rcond=1e-12)
    across = scaled[np.ix_(~inner, inner)]
    own = np.empty(len(v))
    own[inner] = np.diagonal(inverse)
    # Remaining information of each outer component, given the inner ones (Schur).
    unexplained = 1.0 - ((across @ inverse) * across).sum(-1)
    own[~inner] = np.where(unexplained > LEAST_LEFT, 1.0 / np.maximum(unexplained, LEAST_LEFT), 0.0)
    # A variance whose information is only rounding has an infinite error.
    return np.where(own > 0.0, np.sqrt(np.maximum(own, 0.0)), np.inf) / size


def interval(variance: float, error: float) -> tuple[float, float]:
    """95 % interval of a variance with standard error `error`, by Satterthwaite's approximation.

    The estimate v, with standard error s, is taken as chi2-distributed with 2 v^2 / s^2 degrees of freedom; this is
    exact if there is no other component.
    """
    from scipy.special import chdtri

    degrees = 2.0 * min(variance / max(error, 1e-300), MOST_CERTAIN) ** 2
    if degrees < 1.0:
        # The variance is nearly zero: the lower end is zero, and chi2's upper end would tend to infinity.
        return 0.0, variance + NORMAL_95 * error
    # chdtri takes the probability above.
    low, high = chdtri(degrees, (0.025, 0.975))
    return float(degrees * variance / low), float(degrees * variance / high)

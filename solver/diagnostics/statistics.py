"""Intervals, correlations, chi-square bands and jackknife of an estimate."""

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.diagnostics.limits import CHI2_BAND_PROBABILITY
from solver.estimators.estimate import Estimate, require_enough_poses
from solver.estimators.linear_fit import LinearFit


@dataclass(frozen=True, slots=True, kw_only=True)
class Chi2Test:
    """chi2/dof, and the band in which it lies if the noise model is right.

    `per_dof`: chi2 over degrees of freedom. `dof`: degrees of freedom. `low`, `high`: central 99 % band of chi2/dof.
    """

    per_dof: float
    dof: int
    low: float
    high: float


def intervals(estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """Lower and upper ends (P,) of two-sided 95 % intervals of all parameters, rad and m.

    They are normal intervals if the noise is stated or estimated beforehand, and Student's t intervals if the noise is
    calculated from the residuals, as by the `paper` estimator.
    """
    from scipy.special import ndtri, stdtrit

    width = float(stdtrit(estimate.dof, 0.975) if estimate.chi2 is None else ndtri(0.975))
    half = width * estimate.standard_deviation
    return estimate.x - half, estimate.x + half


def correlations(covariance: FloatArray) -> FloatArray:
    """Correlation matrix (P, P); a parameter of variance 0 has the correlation 1 with itself and 0 with all others."""
    sd = np.sqrt(np.diagonal(covariance))
    sure = sd == 0.0
    safe = np.where(sure, 1.0, sd)
    # Divided by the larger first: the product of the two may overflow.
    out = covariance / np.maximum.outer(safe, safe) / np.minimum.outer(safe, safe)
    np.fill_diagonal(out, 1.0)
    return np.asarray(np.clip(out, -1.0, 1.0))


def covariance_root(covariance: FloatArray) -> FloatArray:
    """Matrix R (P, P) with ``R R' = covariance``. The covariance may be singular; negative eigenvalues count as 0."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def sigmas_at(false_alarm: float, count: int = 1) -> float:
    """Magnitude, in sigmas, that the largest of `count` normal deviations exceeds with probability `false_alarm`."""
    from scipy.special import ndtri

    return float(-ndtri(0.5 * false_alarm / max(count, 1)))


def chi2_limit(dof: FloatArray | float, false_alarm: FloatArray | float) -> FloatArray:
    """Value that chi2 with `dof` degrees of freedom exceeds by chance with probability `false_alarm`."""
    from scipy.special import chdtri

    return np.asarray(chdtri(dof, false_alarm), dtype=np.float64)


def chi2_probability(dof: FloatArray | IntArray | float, chi2: FloatArray | float) -> FloatArray:
    """Probability that chance makes chi2 with `dof` degrees of freedom larger than `chi2`."""
    from scipy.special import chdtrc

    return np.asarray(chdtrc(dof, chi2), dtype=np.float64)


def chi2_test(chi2: float, dof: int) -> Chi2Test:
    """Test a weighted sum of squares against its degrees of freedom.

    Raises `ValueError` if no degree of freedom is left.
    """
    if dof <= 0:
        raise ValueError("chi2 needs at least one degree of freedom")
    tail = 0.5 * (1.0 - CHI2_BAND_PROBABILITY)
    return Chi2Test(
        per_dof=chi2 / dof,
        dof=dof,
        low=float(chi2_limit(dof, 1.0 - tail)) / dof,
        high=float(chi2_limit(dof, tail)) / dof,
    )


def jackknife(fit: LinearFit) -> FloatArray:
    """Standard deviation of every parameter (P,), found by leaving out each pose of a mixed model in turn.

    The result is valid even if errors within a pose are correlated or the noise model is wrong, but does not include
    errors common to all poses. Variances are not estimated again. Raises `TooFewPosesError` if one pose fewer leaves no
    degree of freedom.
    """
    design = fit.design
    m = len(design.q)
    require_enough_poses(design.model, m - 1, known=len(design.prior_index))
    steps = fit.without_each()
    apart = steps - steps.mean(axis=0)
    return np.asarray(np.sqrt((m - 1.0) / m * (apart**2).sum(axis=0)))

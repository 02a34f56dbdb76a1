"""Tests of a fit against the stated error model, with false-alarm probabilities, and the search for outliers.

All tests use one linear fit, without a refit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.diagnostics.cross_validation import FOLDS, far_block, fold_poses
from solver.diagnostics.fault_models import FaultModels
from solver.diagnostics.limits import FALSE_ALARM_PROBABILITY, OUTLIER_LARGEST_SHARE
from solver.diagnostics.model_selection import evidence
from solver.diagnostics.statistics import chi2_limit, sigmas_at
from solver.diagnostics.whitened_residuals import WhitenedResiduals
from solver.estimators.layout import UNMODELLED
from solver.estimators.linear_fit import LinearFit

ENTRIES = ("lengths", "twists")
"""Sources of error that are entries of the maker's table."""

SEEN = 1e-6
"""A column is tested only if the fit leaves at least this share of the column's sum of squares."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HypothesisTest:
    """One test, which fires if `statistic` exceeds `threshold`.

    `false_alarm`: probability that the test fires on a pose set without a fault.
    """

    code: str
    statistic: float
    threshold: float
    false_alarm: float = FALSE_ALARM_PROBABILITY

    @property
    def fires(self) -> bool:
        """Whether the statistic is beyond the threshold."""
        return not self.statistic <= self.threshold

    @classmethod
    def of_chi2(cls, code: str, chi2: float, dof: int, *, among: int = 1) -> HypothesisTest:
        """Test `chi2`, which has `dof` degrees of freedom and is the largest of `among` such values."""
        threshold = float(chi2_limit(dof, FALSE_ALARM_PROBABILITY / among))
        return cls(code=code, statistic=chi2, threshold=threshold)

    @classmethod
    def of_squares(
        cls,
        code: str,
        z: FloatArray,
        covariance: FloatArray,
        *,
        false_alarm: float = FALSE_ALARM_PROBABILITY,
    ) -> HypothesisTest:
        """Test the sum of squares of normal deviations `z` (k,), in sigmas, with the given `covariance` (k, k).

        The sum is approximated by a shifted, scaled chi2 of equal mean, variance and skewness (Pearson 1959), which is
        exact for independent deviations.
        """
        mean, square = float(np.trace(covariance)), float((covariance**2).sum())
        dof = square**3 / float(np.trace(covariance @ covariance @ covariance)) ** 2
        return cls(
            code=code,
            statistic=float(z @ z),
            threshold=mean
            + (float(chi2_limit(dof, false_alarm)) - dof) * float(np.sqrt(square / dof)),
            false_alarm=false_alarm,
        )

    @classmethod
    def of_sigmas(
        cls, code: str, z: FloatArray, *, false_alarm: float = FALSE_ALARM_PROBABILITY
    ) -> HypothesisTest:
        """Test the largest magnitude among normal deviations `z` (k,), in sigmas."""
        return cls(
            code=code,
            statistic=float(np.abs(z).max()),
            threshold=sigmas_at(false_alarm, len(z)),
            false_alarm=false_alarm,
        )


def pull_tests(
    stated: LinearFit, false_alarm: float = FALSE_ALARM_PROBABILITY
) -> list[HypothesisTest]:
    """Test how many sigmas lengths and twists deviate from nominal: the largest deviation, and the sum of squares."""
    # Entries of the maker's table are the first of all effects.
    listed = [n for g in stated.design.groups if g.source in ENTRIES for n in g.names]
    own = np.flatnonzero([n in stated.design.errors.tolerance for n in listed])
    covariance = stated.pull_covariance(own)
    known = np.diagonal(covariance) > 0.0
    z, covariance = stated.pulls[own[known]], covariance[np.ix_(known, known)]
    if not len(z):
        return []
    return [
        HypothesisTest.of_sigmas("PULL", z, false_alarm=false_alarm),
        HypothesisTest.of_squares("PULLS", z, covariance, false_alarm=false_alarm),
    ]


def scale_tests(faults: FaultModels, residuals: WhitenedResiduals) -> list[HypothesisTest]:
    """Test every encoder for a scale error. The loops reveal an error of 1 %, which no other test detects."""
    z = []
    for candidate in faults.scales():
        s, C = residuals.score(candidate.columns)
        square = float((residuals.whiten(candidate.columns) ** 2).sum())
        z.append(float(s[0]) / np.sqrt(C[0, 0]) if C[0, 0] > SEEN * square else 0.0)
    return [HypothesisTest.of_sigmas("SCALE", np.array(z))] if z else []


def prediction_test(stated: LinearFit) -> HypothesisTest:
    """Test parts of the poses (`fold_poses`, `far_block`) against predictions from the rest; return the worst test."""
    q = stated.design.q
    parts = (*fold_poses(q), far_block(q)) if len(q) >= 2 * FOLDS else ()
    tests = [HypothesisTest(code="PREDICTION", statistic=0.0, threshold=np.inf)]
    for chi2, dof in stated.held_out_chi2(*parts):
        if dof:
            tests.append(HypothesisTest.of_chi2("PREDICTION", chi2, dof, among=len(parts)))
    return max(tests, key=lambda test: test.statistic / test.threshold)


def variance_tests(stated: LinearFit) -> list[HypothesisTest]:
    """Test for every variance component whether the poses show a larger variance than the stated one.

    The statistic is the slope of the likelihood at the stated variance. It equals a sum of squared errors minus the
    expected sum. The sum is not normal if a component has few errors, e.g. the gain error of one sensor. So a scaled
    chi2 is used, whose degrees of freedom follow from the mean and the variance of the sum (Satterthwaite).
    """
    derivatives = stated.derivatives
    names = [c.name for c in stated.design.components]
    information = np.maximum(np.diagonal(derivatives.information), 1e-300)
    dof = np.maximum(0.5 * derivatives.expected**2 / information, 1e-3)
    largest = (chi2_limit(dof, FALSE_ALARM_PROBABILITY / max(len(names), 1)) - dof) / np.sqrt(
        2.0 * dof
    )
    z = derivatives.score / np.sqrt(information)
    return [
        HypothesisTest(code=f"VARIANCE_{name.upper()}", statistic=float(s), threshold=float(t))
        for name, s, t in zip(names, z, largest, strict=True)
        if name not in ("discrepancy", "placement", UNMODELLED)
    ]


def is_within_specification(
    test: HypothesisTest, faults: FaultModels, residuals: WhitenedResiduals
) -> bool:
    """Whether a test fires because of a linearity deviation that may be within the sensor's specification.

    A specification limits the largest deviation only. A deviation within this limit may still vary more than the error
    model assumes, e.g. as ripples, and fire a test although the sensor is sound. If the loops have not measured the
    deviation, it is fitted to `residuals`.
    """
    joint = test.code.removeprefix("VARIANCE_CURVE_")
    curve = faults.linearity_curve(int(joint)) if test.fires and joint.isdigit() else None
    if curve is None:
        return False
    if curve.measured is not None:
        return not curve.measured.beyond(curve.most_stated)
    fitted = evidence(residuals, curve)
    return fitted is not None and curve.within_specification(fitted.b, fitted.covariance)


OUTLIER_SEARCH_STEPS = 100
"""Approximate upper limit of the number of steps in which poses are set aside."""

SET_ASIDE_SHARE = 0.5
"""A pose is set aside together with the worst pose if its chi2 exceeds the threshold by at least this share of the
amount by which the worst pose's chi2 does."""

FREE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outliers:
    """Result of the search for outliers.

    `test`: test of the worst pose. `poses`: indices of the outliers, the worst first. `rest`: residuals without them.
    """

    test: HypothesisTest
    poses: tuple[int, ...]
    rest: WhitenedResiduals


def find_outliers(residuals: WhitenedResiduals, *, scale: float = 1.0) -> Outliers:
    """Test each pose against its prediction from all others; `scale`: ratio of actual to assumed variances.

    The most improbable pose is set aside and the rest is tested again, so that outliers do not hide each other. With
    many poses, several are set aside at a time to limit the work. The fit itself keeps all poses.
    """
    m = len(residuals.U)
    most = int(np.ceil(OUTLIER_LARGEST_SHARE * m))
    at_once = -(-most // OUTLIER_SEARCH_STEPS)
    is_kept = np.ones(m, dtype=np.bool_)
    chi2_of: dict[int, float] = {}
    first: HypothesisTest | None = None
    rest = residuals
    while True:
        chi2, dof = leave_one_out_chi2(rest.U, rest.white)
        limit = chi2_limit(np.maximum(dof, 1), FALSE_ALARM_PROBABILITY / m)
        chi2 = chi2 / scale
        excess = np.where(is_kept & (dof > 0), chi2 - limit, -np.inf)
        worst = np.argsort(-excess, kind="stable")[:at_once]
        k, largest = worst[0], float(excess[worst[0]])
        first = first or HypothesisTest(
            code="POSE", statistic=float(chi2[k]), threshold=float(limit[k])
        )
        if not largest > 0.0 or len(chi2_of) >= most:
            break
        set_aside = worst[excess[worst] >= SET_ASIDE_SHARE * largest][: most - len(chi2_of)]
        chi2_of |= dict(zip(set_aside.tolist(), chi2[set_aside].tolist(), strict=True))
        is_kept[set_aside] = False
        rest = rest.without(set_aside)
    poses = tuple(sorted(chi2_of, key=lambda pose: -chi2_of[pose]))
    return Outliers(test=first, poses=poses, rest=rest)


def leave_one_out_chi2(U: FloatArray, white: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return chi2 (m,) of each pose against its prediction from all others, and the degrees of freedom (m,) of chi2.

    `U` (m, r, K), `white` (m, r): see `WhitenedResiduals`.
    """
    H = np.eye(U.shape[1]) - U @ np.swapaxes(U, -1, -2)
    values, vectors = np.linalg.eigh(H)
    free = values > FREE
    along = (np.swapaxes(vectors, -1, -2) @ white[..., None])[..., 0]
    chi2 = np.where(free, along**2 / np.where(free, values, 1.0), 0.0)
    return np.asarray(chi2.sum(-1)), np.asarray(free.sum(-1))

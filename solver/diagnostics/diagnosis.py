"""Diagnosis of a fit: tests against the stated error model, and the faults that best explain a failed test.

The tests and the fault models share one linear fit at the stated variances. If a test fires, possible faults are
compared, and the fault that explains the residuals best is fitted as well. This is repeated until no test fires.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import log

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.diagnostics import limits
from solver.diagnostics.change_points import steps
from solver.diagnostics.fault_models import Candidate, Cause, FaultModels, PeakDeviation
from solver.diagnostics.hypothesis_tests import (
    HypothesisTest,
    Outliers,
    find_outliers,
    is_within_specification,
    prediction_test,
    pull_tests,
    scale_tests,
    variance_tests,
)
from solver.diagnostics.model_selection import (
    Explanation,
    evidence,
    log_likelihood,
    noise_scale,
    probabilities,
)
from solver.diagnostics.stated_sizes import with_estimated_motion_noise
from solver.diagnostics.whitened_residuals import PoseNoise, WhitenedResiduals
from solver.estimators.linear_fit import LinearFit

UNNAMED = 0.002
"""Prior probability of a cause that is not in `Cause`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CauseRanking:
    """Explanations that were compared, the most probable first, and the probability of an unknown cause."""

    known: tuple[Explanation, ...]
    unknown: float

    @property
    def best(self) -> Explanation | None:
        """The most probable explanation; None if an unknown cause is more probable."""
        return next((x for x in self.known if x.probability >= self.unknown), None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
    """Results of `diagnose`.

    `rankings`: rankings of the possible causes. The first is for the residuals of the fit. Each later one is for the
    residuals that remain once the best causes of all earlier rankings are fitted.
    `suspected_entries`: lengths and twists that may differ from the arm file although no test fires, the most probable
    first.
    `residuals`: residuals, poses in time order, whitened with the smaller of the estimated and the stated noise.
    `stated_chi2_per_dof`: chi2/dof at the stated variances.
    `parameter_shift` (P,): parameters fitted at the stated variances minus those of the diagnosed fit, rad and m.
    """

    tests: tuple[HypothesisTest, ...]
    rankings: tuple[CauseRanking, ...]
    suspected_entries: tuple[Explanation, ...]
    residuals: WhitenedResiduals
    stated_chi2_per_dof: float
    parameter_shift: FloatArray
    faults: FaultModels

    @property
    def fires(self) -> bool:
        """Whether any test fires."""
        return any(test.fires for test in self.tests)

    @property
    def best(self) -> Explanation | None:
        """The most probable single explanation; None if no test fires, or if an unknown cause is more probable."""
        return self.rankings[0].best if self.rankings else None


def diagnose(
    fit: LinearFit,
    arm: ArmModel,
    *,
    taken: IntArray,
    measured: Mapping[int, PeakDeviation] | None = None,
) -> Diagnosis:
    """Test a fit, and rank the faults that may explain a failed test.

    `fit`: the mixed model at its solution. The fit is tested at the *stated* variances. Outliers, steps and scales of
    encoders are tested at the estimated noise if that is smaller.
    `taken` (m,): position of each pose of the fit in time order.
    `measured`: by joint (1-based), the sensor's linearity deviation as measured by loops that do not use its readings.
    """
    stated = fit.stated
    order = np.argsort(taken, kind="stable")
    faults = FaultModels(arm, stated, order, measured or {})
    residuals = residuals_of_fit(fit.at_known_noise, order)
    low_noise = residuals_of_fit(with_estimated_motion_noise(fit), order)
    outliers, residual_tests = _residual_tests(faults, residuals, low_noise)
    tests = (
        HypothesisTest.of_chi2("CHI2_STATED", stated.chi2, stated.dof),
        *residual_tests,
        *pull_tests(stated),
        *(t for t in variance_tests(stated) if not is_within_specification(t, faults, residuals)),
        prediction_test(stated),
        *scale_tests(faults, residuals),
    )
    fires = any(test.fires for test in tests)
    doubtful = not fires and any(
        test.fires for test in pull_tests(stated, limits.ENTRY_SUSPICION_PROBABILITY)
    )
    rankings = tuple(_explanations(faults, residuals, outliers)) if fires else ()
    suspected = next(_explanations(faults, residuals, outliers)).known if doubtful else ()
    return Diagnosis(
        tests=tests,
        rankings=rankings,
        suspected_entries=tuple(
            x for x in suspected if x.candidate.cause in (Cause.LENGTH, Cause.TWIST)
        ),
        residuals=residuals,
        stated_chi2_per_dof=stated.chi2 / max(stated.dof, 1),
        parameter_shift=stated.change - fit.change,
        faults=faults,
    )


def _residual_tests(
    faults: FaultModels, residuals: WhitenedResiduals, low_noise: WhitenedResiduals
) -> tuple[Outliers, list[HypothesisTest]]:
    """Search for outliers and steps; return the outliers, the test for them, and the test of the most significant step.

    Outliers and steps of the geometry are searched for in `residuals`, which are whitened by the noise of the fit.
    Steps of a joint's reading are searched for in `low_noise`, with smaller motion noise if the poses show less. In
    these, badly modelled deflections would look like steps of the geometry. Noise is not scaled down to the size of the
    residuals: one sensor may exceed its specification while most errors are smaller than stated.
    """
    outliers = find_outliers(residuals)
    worst = steps(residuals, faults.changes(), low_noise=low_noise)[:1]
    tests = [HypothesisTest(code="STEP", statistic=s.chi2, threshold=s.threshold) for s in worst]
    return outliers, [outliers.test, *tests]


def _explanations(
    faults: FaultModels, residuals: WhitenedResiduals, outliers: Outliers
) -> Iterator[CauseRanking]:
    """Yield rankings of possible causes. Before each further ranking, the best cause of the previous one is fitted.

    The rankings end when no test fires, when no cause explains the residuals, or after `limits.MOST_CAUSES_FITTED`.
    """
    persistent_faults = tuple(faults.persistent_faults())
    for _ in range(limits.MOST_CAUSES_FITTED):
        ranking = _ranked(residuals, (*_changes(faults, residuals, outliers), *persistent_faults))
        yield ranking
        best = ranking.best
        if best is None or best.chi2_per_dof > limits.CHI2_PER_DOF_GROSS:
            # No linear cause explains this.
            return
        cause, sd = best.candidate, best.size * best.candidate.expected_size
        if cause.own is None:
            residuals = residuals.with_columns(cause.columns, sd)
        else:
            own = cause.columns * sd.reshape(len(cause.own), 1, -1)
            residuals = PoseNoise(residuals, cause.own, own).residuals()
        outliers, tests = _residual_tests(faults, residuals, residuals)
        tests.append(HypothesisTest.of_chi2("CHI2_STATED", residuals.chi2, residuals.dof))
        if not any(test.fires for test in tests):
            return


def _changes(
    faults: FaultModels, residuals: WhitenedResiduals, outliers: Outliers
) -> Iterable[Candidate]:
    """Yield candidates for step changes at some pose, then for the 1, 2, 3 most probable outliers and all of them.

    `outliers`: result of the search for outliers with the noise as large as stated.
    """
    scale = float(noise_scale(residuals.chi2, residuals.dof))
    for step in steps(residuals, faults.changes(), scale=scale):
        yield step.suspect.from_pose(step.pose)
    poses = (outliers if scale == 1.0 else find_outliers(residuals, scale=scale)).poses
    m = len(residuals.white)
    for count in range(1, len(poses) + 1):
        if count in (1, 2, 3, len(poses)):
            own = np.array(poses[:count])
            yield Candidate(
                cause=Cause.OUTLIERS,
                subject="",
                # One column for each equation, in units of noise: fitting them omits the poses.
                columns=np.linalg.inv(residuals.whitener[own]),
                own=own,
                expected_size=np.full(count * residuals.white.shape[1], 3.0),
                places=m**count,
                poses=poses[:count],
            )


def _ranked(residuals: WhitenedResiduals, candidates: Iterable[Candidate]) -> CauseRanking:
    known = [
        x
        for c in candidates
        if (x := evidence(residuals, c))
        and not c.within_specification(x.b, x.covariance)
        and float(np.sqrt(np.mean((x.b / c.expected_size) ** 2))) <= c.most
    ]
    counts = Counter(x.candidate.cause for x in known)
    weights = [
        x.log_likelihood
        + np.log(x.candidate.cause.prior / counts[x.candidate.cause])
        - log(x.candidate.places)
        # If the remaining misfit exceeds the stated errors, there must be a second, unknown cause.
        + (np.log(UNNAMED) if x.chi2_per_dof > limits.CHI2_PER_DOF_EXPLAINED else 0.0)
        for x in known
    ]
    no_fault = np.log(1.0 - sum(cause.prior for cause in Cause))
    weights += [
        log_likelihood(residuals.chi2, residuals.dof, most_noise=1.0) + no_fault,
        log_likelihood(residuals.chi2, residuals.dof) + np.log(UNNAMED),
    ]
    chance = probabilities(np.array(weights))
    known = [replace(x, probability=p) for x, p in zip(known, chance[:-2].tolist(), strict=True)]
    known.sort(key=lambda x: -x.probability)
    unknown = float(chance[-1])
    return CauseRanking(
        known=tuple(
            x
            for k, x in enumerate(known)
            if x.probability >= limits.LEAST_REPORTED_CAUSE_PROBABILITY
            or (k == 0 and x.probability >= unknown)
        ),
        unknown=unknown,
    )


def residuals_of_fit(fit: LinearFit, order: IntArray) -> WhitenedResiduals:
    """Return the whitened residuals of a mixed model, poses in the given `order` (m,)."""
    design, half = fit.design, fit.half
    position = np.argsort(order)
    m, r = len(design.q), design.model.equations_per_pose
    whitener, U, white = np.empty((m, r, r)), np.empty((m, r, design.width)), np.empty((m, r))
    for part in fit.parts():
        rows = position[part.poses]
        whitener[rows] = part.L_inverse
        U[rows] = fit.orthonormal(part)
        white[rows] = part.w + part.times(fit.coefficients)
    return WhitenedResiduals(
        whitener=whitener,
        U=U,
        white=white,
        chi2=fit.chi2,
        to_x=half[design.column] * fit.unit[:, None],
        dof=fit.dof,
    )

"""Adjudication: finds the causes of a misfit, and the verdict, from a fit, its tests and the checks made before them.

Other models are fitted only if the fit is poor or its solution is implausible.
"""

from dataclasses import dataclass, replace

import numpy as np

from fixtures.base import CheckKind, SetupCheck, Severity
from operator_app.calibration import acceptance
from operator_app.calibration.alternatives import (
    find_alternatives,
    hinge_alternative,
    poses_in_radians,
    refuted_distances,
    step_alternative,
    turned_zero,
    wrong_distances,
)
from operator_app.calibration.experiment import Experiment, placement_checks
from operator_app.calibration.findings import exceeded, motion_causes, pose_labels, range_finding
from operator_app.calibration.multistart import (
    has_diverged,
    local_minimum_causes,
    of_fixture,
)
from operator_app.calibration.placements import contradicted
from operator_app.calibration.repeat_measurement import Repeat
from operator_app.calibration.result import Solution
from operator_app.calibration.rvdt import measured_deviations, rvdt_causes
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import IntArray
from solver.chain.parameters import nominal_vector
from solver.diagnostics import limits
from solver.diagnostics.diagnosis import Diagnosis, diagnose
from solver.diagnostics.fault_models import Cause
from solver.diagnostics.range_checks import RangeFinding
from solver.diagnostics.stated_sizes import exceeded_specifications
from solver.estimators.linear_fit import LinearFit
from solver.estimators.mixed_fit import expected_fit
from solver.estimators.variance_components import Calibrated
from solver.loops.closure import ClosureModel
from solver.search.global_start import GlobalStart

UNEXPLAINED_KINDS = {
    FindingKind.UNEXPLAINED_SCATTER,
    FindingKind.UNEXPLAINED_PATTERN,
    FindingKind.POSES_DO_NOT_FIT,
}
"""Kinds of findings for a misfit that no fault explains."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorInformation:
    """Results that the adjudication uses in addition to the tests of the fit.

    `out_of_range`: readings outside the arm file's ranges.
    `left_out`: findings that state why poses were left out.
    `checks`: set-up checks of the fixture's identified geometry.
    `returned`: comparisons of the two readings of each repeated pose.
    """

    out_of_range: tuple[RangeFinding, ...]
    left_out: tuple[Finding, ...]
    checks: tuple[SetupCheck, ...]
    returned: tuple[Repeat, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Case:
    """A solution without its verdict, the implicit fit of its poses, and the diagnosis of the misfit.

    `stated`: the experiment with the files' values and the fitted poses in the order in which they were taken.
    """

    solution: Solution
    fit: Calibrated
    stated: Experiment
    diagnosis: Diagnosis

    @property
    def model(self) -> ClosureModel:
        return self.fit.linear.design.model

    @property
    def gross(self) -> bool:
        """Whether the misfit remains too large even if the most probable single fault is added to the linear fit."""
        best = self.diagnosis.best
        least = self.diagnosis.stated_chi2_per_dof if best is None else best.chi2_per_dof
        return least > limits.CHI2_PER_DOF_REFUSED

    def suspects(self, *causes: Cause) -> str:
        """Return the joint or part with the most probable fault, if this fault is one of `causes`; otherwise ""."""
        best = self.diagnosis.best
        return best.candidate.subject if best is not None and best.candidate.cause in causes else ""

    def alternatives(self, *, near: bool = False, of_files: bool = False) -> tuple[Finding, ...]:
        dof = self.diagnosis.residuals.dof
        return turned_zero(self.stated, self.fit.estimate) or find_alternatives(
            self.stated,
            scale=self.diagnosis.stated_chi2_per_dof,
            dof=dof,
            near=near,
            of_files=of_files,
        )


def adjudicate(
    solution: Solution,
    calibrated: Calibrated,
    experiment: Experiment,
    distinct: IntArray,
    known: PriorInformation,
) -> acceptance.Adjudication:
    """Return the verdict on `solution` with all tests and the causes of a misfit, the main cause first.

    `calibrated`: implicit fit. `distinct`: indices of its poses, in the order in which they were taken.
    """
    arm, by_paper = experiment.arm, solution.estimate.estimator == "paper"
    measured = measured_deviations(solution.rvdt, arm)
    case = _Case(
        solution=solution,
        fit=calibrated,
        stated=experiment.at_poses(distinct),
        diagnosis=diagnose(calibrated.linear, arm, taken=calibrated.order, measured=measured),
    )
    labels, scale = pose_labels(case.stated.poses), case.diagnosis.stated_chi2_per_dof
    by_tests, alternatives, nothing_fits = _misfit_causes(case, labels)
    # If nothing fits, e.g. with poses of another arm, the solution has no meaning.
    far = () if nothing_fits else _local_minimum_causes(case)
    # If one cause explains the misfit, the fixture may be anywhere: the poses determine its place.
    anywhere = () if far or nothing_fits or case.gross else of_fixture(case.model)
    diverged = has_diverged((*far, *by_tests), scale, solution.identified, anywhere=anywhere)
    lost = _poorly_determined(case) if far or case.gross or diverged else ()
    of_returns, since = acceptance.return_tests(known.returned, calibrated.estimate)
    of_paper, off_paper = (
        acceptance.paper_test(solution.estimate, calibrated.estimate) if by_paper else ((), ())
    )
    of_fit = _fit_causes(case, without_sigmas=bool(lost) or case.gross or diverged)
    if far or any(cause.blocking for cause in of_fit):
        of_fit = (*hinge_alternative(case.stated), *of_fit)
    if alternatives:
        # The corrected model closes the loops: it explains the large sigmas and the values far from nominal.
        far, lost = (), ()
    first = (
        *_screening_causes(solution, experiment, known),
        *lost,
        *(() if case.gross or diverged else _geometry_causes(known.checks)),
        *(() if case.gross else far),
    )
    moved = motion_causes(case.stated, labels)
    if not solution.estimate.converged:
        by_tests, moved = _blocking_when_probable(by_tests), _blocking_when_probable(moved)
    proven, by_tests = acceptance.proven_by_return(since, by_tests)
    if not any(cause.blocking for cause in first):
        first, proven = (*proven, *first), ()
    # An alternative model also explains readings out of range: it comes first.
    first, by_tests = ((*by_tests, *first), ()) if alternatives else (first, by_tests)
    # The paper's estimate does not use measured distances, and a gross misfit does not show which distances are wrong.
    used = not (by_paper or case.gross)
    distances = contradicted(case.stated, calibrated.linear) if used else ()
    named = {(c.kind, c.joints) for c in (*first, *by_tests)}
    return acceptance.Adjudication(
        causes=(
            *first,
            *proven,
            *by_tests,
            *(c for c in acceptance.not_yet_named(since, by_tests) if not c.blocking),
            *moved,
            *(far if case.gross else ()),
            *off_paper,
            *(c for c in distances if (c.kind, c.joints) not in named),
            *of_fit,
        ),
        tests=(*case.diagnosis.tests, *of_returns, *of_paper),
        stated_chi2_per_dof=scale,
        diverged=diverged,
    )


def _misfit_causes(
    case: _Case, labels: tuple[str, ...]
) -> tuple[tuple[Finding, ...], tuple[Finding, ...], bool]:
    """Explain the misfit by the causes that the tests support or, if it is gross, by alternative models.

    Returns all causes, those of them that are alternative models, and whether a misfit that blocks stays unexplained.
    """
    diagnosis, scale = case.diagnosis, case.diagnosis.stated_chi2_per_dof
    judged = tuple(p.name for p in case.solution.identified.parameters)
    by_tests = acceptance.causes_of(diagnosis, case.fit.estimate, judged, labels)
    if alternatives := poses_in_radians(case.stated, scale):
        return alternatives, alternatives, False
    wrong = _wrong_distances(case, limits.EQUALLY_GOOD_CHI2) if diagnosis.fires else ()
    # A step between two placements changes the distance of their sockets: it may explain the misfit too.
    step = bool(wrong) and not case.gross and _begins_with_a_placement(case)
    if wrong and not (step and not _wrong_distances(case, -limits.EQUALLY_GOOD_CHI2, again=False)):
        return wrong, wrong, False
    if len(wrong) == 1:
        either = (*wrong, *(replace(c, blocking=True) for c in by_tests[:1]))
        return tuple(replace(c, probability=0.5) for c in either), wrong, False
    joint = "" if case.gross else case.suspects(Cause.READING)
    # If an error of a reading, compliance or length is this large, a file may be wrong instead.
    of_files = (
        not case.gross
        and scale > limits.CHI2_PER_DOF_REFUSED
        and bool(joint or case.suspects(Cause.GIVES, Cause.LENGTH, Cause.TWIST))
    )
    if case.gross or of_files:
        # Linear explanations are invalid far from the truth.
        alternatives = case.alternatives(of_files=of_files)
        by_tests = alternatives or by_tests
    if joint and not alternatives:
        # The joint's readings may be wrong in every pose independently, or from one pose on.
        by_tests = step_alternative(case.stated, int(joint), scale) or by_tests
    elif not (by_tests or case.gross or of_files):
        by_tests = rvdt_causes(case.solution.rvdt, case.stated.arm)
    unexplained = (
        len(by_tests) == 1 and by_tests[0].blocking and by_tests[0].kind in UNEXPLAINED_KINDS
    )
    nothing_fits = unexplained and not alternatives
    explained = not (alternatives or case.gross or nothing_fits)
    if by_tests and explained and not _single_cause(diagnosis):
        by_tests = (*_exceeded_specifications(case.fit.linear, diagnosis), *by_tests)
    if scale > limits.CHI2_PER_DOF_REFUSED and by_tests:
        # The misfit has widened the sigmas, so that no cause's effect exceeds them: the first has to block.
        by_tests = (replace(by_tests[0], blocking=True), *by_tests[1:])
    return by_tests, alternatives, nothing_fits


def _wrong_distances(case: _Case, margin: float, *, again: bool = True) -> tuple[Finding, ...]:
    """Return findings of measured socket distances that may be wrong; empty if there are none.

    Without these distances, chi2 is at most `margin` above the chi2 of a fit of the most probable fault.
    `again`: whether the loops may be solved again without the distances; if not, only the linear fit is used.
    """
    if again and (case.gross or not case.fit.estimate.converged):
        return refuted_distances(case.stated)
    best = case.diagnosis.best
    most_chi2 = np.inf if best is None else best.chi2 + margin
    return wrong_distances(case.stated, case.fit.linear, most_chi2=most_chi2, again=again)


def _begins_with_a_placement(case: _Case) -> bool:
    best, placement = case.diagnosis.best, case.stated.poses.placement
    if best is None or best.candidate.cause not in (Cause.SLIPPED, Cause.LOST_COUNTS):
        return False
    (first,) = best.candidate.poses
    return bool(placement[first] != placement[first - 1])


def _local_minimum_causes(case: _Case) -> tuple[Finding, ...]:
    """Return findings that the solution may be only a local minimum; alternative models near nominal come first."""
    if case.solution.search is not None:
        return ()
    design = case.fit.linear.design
    q = None if case.model.unsensed_joints else design.q
    identified = case.fit.estimate.without(design.errors.tolerance)
    far = local_minimum_causes(case.model, identified, q)
    if far and q is not None and not case.gross:
        return (*case.alternatives(near=True), *far)
    return far


def _fit_causes(case: _Case, *, without_sigmas: bool) -> tuple[Finding, ...]:
    """Return the causes that the fit itself shows: it has not converged, or sigmas are large.

    `without_sigmas`: whether to leave out the check of the sigmas, in which `Solution.by_files` count as exact.
    """
    estimate = case.solution.estimate.given(case.solution.by_files)
    open_end = Finding(
        FindingKind.NOT_CONVERGED, figures={"iterations": estimate.iterations}, blocking=True
    )
    # The arm's free entries are to be identified: the fixture's file states nothing about them.
    placed, arms = case.stated.fixture.tolerance, {entry.name for entry in case.stated.arm.free}
    stated_by_fixture = {
        p.name: placed.orientation_rad if p.is_angle else placed.position_m
        for p in case.model.parameters
        if p.name.split("[")[0] not in arms
    }
    identified = estimate.without(case.solution.tolerated)
    wide = acceptance.little_motion(identified, stated_by_fixture, case.fit)
    return (*(() if estimate.converged else (open_end,)), *(() if without_sigmas else wide))


def _poorly_determined(case: _Case) -> tuple[Finding, ...]:
    """Return findings on parameters that neither these poses nor the files determine well.

    The sigmas are computed at the nominal values, because the sigmas of a diverged fit have no meaning. The result is
    empty if axes are parallel at the nominal values, since this is then the cause.
    """
    design, model = case.fit.linear.design, case.model
    nominal = nominal_vector(model.parameters)
    stated = case.stated
    if _geometry_causes(placement_checks(stated, model, nominal)):
        return ()
    group = stated.poses.placement[case.fit.order]
    fit = expected_fit(model, design.q, design.errors, nominal, group=group)
    expected = replace(case.fit.estimate, covariance=fit.covariance)
    if case.gross:
        # A gross misfit has another cause, unless parameters that the files do not determine have useless sigmas.
        expected = expected.given(case.solution.by_files)
    causes = acceptance.little_motion(expected.without(design.errors.tolerance))
    if case.gross:
        return tuple(cause for cause in causes if cause.blocking)
    return tuple(replace(cause, blocking=True) for cause in causes)


def _single_cause(diagnosis: Diagnosis) -> bool:
    """Whether one cause of probability above 0.5 explains the misfit; true if there is no misfit."""
    if (best := diagnosis.best) is None:
        return not diagnosis.rankings
    return best.probability > 0.5 and best.chi2_per_dof <= limits.CHI2_PER_DOF_EXPLAINED


def _blocking_when_probable(causes: tuple[Finding, ...]) -> tuple[Finding, ...]:
    return tuple(replace(c, blocking=c.blocking or c.probability > 0.5) for c in causes)


def _exceeded_specifications(fit: LinearFit, diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Return findings of error sources beyond their specification; the parameters' sigmas already include the excess.

    A linearity deviation is included only if the test for it fires.
    """
    by_source: dict[str, Finding] = {}
    fired = {test.code for test in diagnosis.tests if test.fires}
    for larger in exceeded_specifications(fit):
        code = f"VARIANCE_{larger.component.upper()}"
        if larger.component.startswith("curve_") and code not in fired:
            continue
        finding = exceeded(larger, fit.design)
        chance = 1.0 - float(np.exp(larger.log_chance))
        by_source.setdefault(finding.code, replace(finding, probability=chance))
    return tuple(by_source.values())[: limits.MOST_SOURCES_REPORTED]


def _screening_causes(
    solution: Solution, experiment: Experiment, known: PriorInformation
) -> tuple[Finding, ...]:
    many = len(solution.dropped_flipped) > limits.FLIPPED_SHARE_REFUSED * len(experiment.poses)
    return (
        *(replace(f, blocking=many) for f in known.left_out),
        *(range_finding(f, experiment) for f in known.out_of_range),
        *second_solution(solution.search),
        *acceptance.too_few_poses(solution.estimate),
    )


def second_solution(search: GlobalStart | None) -> tuple[Finding, ...]:
    """Return a finding if several solutions of the global search fit; empty if only one does or `search` is None."""
    if search is None or not search.alternatives:
        return ()
    solutions = {"solutions": 1 + len(search.alternatives)}
    return (Finding(FindingKind.SECOND_SOLUTION, figures=solutions, blocking=True),)


def _geometry_causes(checks: tuple[SetupCheck, ...]) -> tuple[Finding, ...]:
    """Return a finding for each joint axis almost parallel to a fixture axis: D-H entries are ambiguous (Hayati)."""
    return tuple(
        Finding(
            FindingKind.PARALLEL_AXES,
            joint=c.joint,
            reported=(c.text, c.remedy),
            blocking=c.severity is Severity.REFUSED,
        )
        for c in checks
        if c.kind is CheckKind.AXIS_ANGLE and c.severity is not Severity.OK
    )

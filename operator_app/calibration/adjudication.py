"""From a fit to its verdict: what was known before, what the tests say, what else would explain it.

Knows calibrations, files' objects and verdicts; no screen. Solves anew only when a test fires.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fixtures.base import CheckKind, Fixture, SetupCheck, Severity
from operator_app.calibration.acceptance import (
    Judgement,
    causes_of,
    fit_causes,
    little_motion,
    paper_test,
    too_few_poses,
)
from operator_app.calibration.alternatives import (
    find_alternatives,
    hinge_alternative,
    step_alternative,
)
from operator_app.calibration.closed_loops import pick
from operator_app.calibration.excluded_poses import excluded_poses, out_of_range_besides
from operator_app.calibration.findings import exceeded, range_finding
from operator_app.calibration.local_minima import has_diverged, other_basin
from operator_app.calibration.motion_during_sampling import motion_causes
from operator_app.calibration.refusals import placement_checks
from operator_app.calibration.repeat_diagnosis import not_yet_named, proven_by_return, return_tests
from operator_app.calibration.repeat_measurement import Repeat, Reread
from operator_app.calibration.rvdt import measured_deviations, rvdt_causes
from operator_app.calibration.sensitivity import exceeded_source
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import Parameter, nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics.diagnosis import Diagnosis, diagnose
from solver.diagnostics.fault_candidate import Cause
from solver.diagnostics.limits import (
    CHI2_PER_DOF_EXPLAINED,
    CHI2_PER_DOF_REFUSED,
    FLIPPED_SHARE_REFUSED,
    MOST_SOURCES_REPORTED,
)
from solver.diagnostics.range_checks import RangeFinding
from solver.diagnostics.rvdt import RvdtVerdict
from solver.diagnostics.stated_sizes import exceeded_specifications
from solver.estimators.estimate import Estimate
from solver.estimators.linear_fit import LinearFit
from solver.estimators.mixed_fit import expected_fit
from solver.estimators.variance_components import Calibrated
from solver.search.global_start import GlobalStart

UNEXPLAINED = {
    FindingKind.UNEXPLAINED_SCATTER,
    FindingKind.UNEXPLAINED_PATTERN,
    FindingKind.POSES_DO_NOT_FIT,
}
"""What is found where no fault explains the readings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorInformation:
    """What was seen before and beside the fit.

    Attributes
    ----------
    out_of_range, flipped
        Readings the arm file does not allow, and poses left out: the hand is upside down in them, or seems so.
    checks
        The fixture's geometry as it was found.
    search
        The global start, where one was asked for.
    rvdt
        What the loops say of each RVDT.
    returned
        Poses that were read again, and what that says.
    by_files
        Parameters of which the poses brought less than half of what is known.
    """

    out_of_range: tuple[RangeFinding, ...] = ()
    flipped: tuple[int, ...] = ()
    checks: tuple[SetupCheck, ...] = ()
    search: GlobalStart | None = None
    rvdt: tuple[RvdtVerdict, ...] = ()
    returned: tuple[tuple[Reread, Repeat], ...] = ()
    by_files: tuple[str, ...] = ()


def adjudicate(
    found: Calibrated,
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    distinct: IntArray,
    *,
    judged: tuple[str, ...],
    known: PriorInformation,
    paper: Estimate | None = None,
) -> Judgement:
    """Judge a fit.

    Parameters
    ----------
    poses, distinct
        All poses, and the indices of those that the fit was made of, in the order they were taken.
    judged
        Names of the parameters whose sigmas have to hold.
    paper
        The paper's estimate, where that is to be judged.
    """
    judging = found.estimate if paper is None else paper
    used = pick(poses, distinct)
    diagnosis = diagnose(
        found.linear, arm, taken=found.order, measured=measured_deviations(known.rvdt, arm)
    )
    design = found.linear.design
    model = design.model
    unsensed = model.unsensed_joints
    scale = diagnosis.stated_chi2_per_dof
    gross = _unexplained_chi2_per_dof(diagnosis) > CHI2_PER_DOF_REFUSED
    by_tests = causes_of(diagnosis, found.estimate, judged, _labels(used))
    rivals: tuple[Finding, ...] = ()
    if gross:
        # Linear explanations end where nothing is near the truth any more.
        rivals = find_alternatives(
            arm, fixture, used, unsensed=unsensed, scale=scale, dof=diagnosis.left.dof
        )
        by_tests = rivals or by_tests
    elif scale > CHI2_PER_DOF_REFUSED and _geometry_suspected(diagnosis):
        # A fixture that gives, or a length that is off, by so much may as well be a file that is wrong.
        rivals = find_alternatives(
            arm,
            fixture,
            used,
            unsensed=unsensed,
            scale=scale,
            dof=diagnosis.left.dof,
            of_files=True,
        )
        by_tests = rivals or by_tests
    elif joint := _suspected_reading(diagnosis):
        by_tests = (
            step_alternative(arm, fixture, used, unsensed=unsensed, joint=joint, scale=scale)
            or by_tests
        )
    elif not by_tests:
        by_tests = rvdt_causes(known.rvdt, arm)
    nothing_fits = (
        not rivals
        and len(by_tests) == 1
        and by_tests[0].blocking
        and by_tests[0].kind in UNEXPLAINED
    )
    if by_tests and not (rivals or gross or nothing_fits) and not _single_cause(diagnosis):
        by_tests = (*_exceeded_specifications(found.linear, diagnosis), *by_tests)
    if scale > CHI2_PER_DOF_REFUSED and by_tests:
        # What is named may move nothing by more than its sigmas: these are as wide as the misfit made them.
        by_tests = (replace(by_tests[0], blocking=True), *by_tests[1:])
    # Where poses of another arm lead these files' loops says nothing.
    far = (
        other_basin(model, found.estimate, design.q, judged)
        if known.search is None and not unsensed and not nothing_fits
        else ()
    )
    if far and not gross:
        # It fits, but is it the arm of the files? A mistake that fits as well and is near them is likelier.
        far = (
            *find_alternatives(
                arm,
                fixture,
                used,
                unsensed=unsensed,
                scale=scale,
                dof=diagnosis.left.dof,
                near=True,
            ),
            *far,
        )
    diverged = has_diverged((*far, *by_tests), scale, judging, judged)
    lost = _poorly_determined(found, used, fixture, arm, judged) if far or gross or diverged else ()
    of_returns, since = return_tests(known.returned, found.estimate)
    tests = (*diagnosis.tests, *of_returns)
    of_paper: tuple[Finding, ...] = ()
    if paper is not None:
        test, of_paper = paper_test(paper, found.estimate)
        tests = (*tests, test)
    # What files tell of a parameter is no fault of the poses, nor what follows from it of others.
    of_fit = fit_causes(
        judging.given(known.by_files),
        judged,
        stated_by_fixture(model.parameters, arm, fixture),
        partial(exceeded_source, found),
    )
    if lost or diverged:
        # Said already as it is at the nominal values; where the solution is astray its sigmas tell of no pose.
        of_fit = tuple(
            cause
            for cause in of_fit
            if cause.kind not in (FindingKind.SIGMAS_USELESS, FindingKind.SIGMAS_WIDE)
        )
    if far or any(cause.blocking for cause in of_fit):
        of_fit = (*hinge_alternative(arm, fixture, used, unsensed=unsensed), *of_fit)
    first = (
        *_screening_causes(arm, poses, known),
        *too_few_poses(judging),
        *lost,
        *(() if gross or diverged else _geometry_causes(known.checks)),
        *(() if gross else far),
    )
    shaken = motion_causes(arm, used, unsensed, _labels(used))
    if not judging.converged:
        by_tests, shaken = _refusing_when_likely(by_tests), _refusing_when_likely(shaken)
    slipped, by_tests = proven_by_return(since, by_tests)
    if not any(cause.blocking for cause in first):
        first, slipped = (*slipped, *first), ()
    return Judgement(
        causes=(
            *first,
            *slipped,
            *by_tests,
            *(c for c in not_yet_named(since, by_tests) if not c.blocking),
            *shaken,
            *(far if gross and not rivals else ()),
            *of_paper,
            *of_fit,
        ),
        tests=tests,
        stated_chi2_per_dof=scale,
        diverged=diverged,
    )


def stated_by_fixture(
    parameters: tuple[Parameter, ...], arm: ArmModel, fixture: Fixture
) -> dict[str, float]:
    """How well (rad, m) the fixture's file states each of its own entries, by name.

    Not the arm's: its offsets are what is looked for.
    """
    placed = fixture.tolerance
    arms = {entry.name for entry in arm.free}
    return {
        p.name: placed.orientation_rad if p.is_angle else placed.position_m
        for p in parameters
        if p.name.split("[")[0] not in arms
    }


def _poorly_determined(
    found: Calibrated, used: PoseSet, fixture: Fixture, arm: ArmModel, judged: tuple[str, ...]
) -> tuple[Finding, ...]:
    """What such poses hardly tell wherever the solution lies, so that it may have ended anywhere.

    Judged at the nominal values: where a fit has gone astray its own sigmas mean nothing. Not where the
    nominal geometry itself is to blame.
    """
    design = found.linear.design
    model = design.model
    nominal = nominal_vector(model.parameters)
    checks = placement_checks(fixture, arm, model, nominal)
    if _geometry_causes(checks):
        return ()
    expected = expected_fit(
        model, design.q, design.errors, nominal, group=used.placement[found.order]
    )
    sd = np.sqrt(np.maximum(np.diagonal(expected.covariance), 0.0))
    return tuple(
        replace(cause, blocking=True) for cause in little_motion(model.parameters, sd, judged)
    )


def _labels(poses: PoseSet) -> tuple[str, ...]:
    """Labels of poses, with the placement where each of several has a pose 1."""
    if len(poses.placements) == 1:
        return poses.label
    return tuple(
        f"{label} of placement {number}"
        for label, number in zip(poses.label, poses.placement, strict=True)
    )


def _single_cause(diagnosis: Diagnosis) -> bool:
    """Whether one cause explains it, likelier than all others together."""
    if not diagnosis.rounds:
        return True
    best = diagnosis.rounds[0][0]
    if best.candidate is None or best.evidence is None:
        return False
    return best.probability > 0.5 and best.evidence.chi2 <= CHI2_PER_DOF_EXPLAINED * max(
        best.evidence.dof, 1
    )


def _suspected_reading(diagnosis: Diagnosis) -> int:
    """Joint (1-based) whose reading explains it best if it is wrong in every pose in its own way; 0 if none."""
    best = diagnosis.rounds[0][0].candidate if diagnosis.rounds else None
    return 0 if best is None or best.cause is not Cause.READING else int(best.subject)


def _geometry_suspected(diagnosis: Diagnosis) -> bool:
    """Whether a fixture that gives, or an entry of the arm's table, explains it best."""
    best = diagnosis.rounds[0][0].candidate if diagnosis.rounds else None
    return best is not None and best.cause in (Cause.GIVES, Cause.LENGTH, Cause.TWIST)


def _refusing_when_likely(causes: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """What is likely wrong is why the iteration did not settle: that it did not is no help."""
    return tuple(replace(c, blocking=c.blocking or c.probability > 0.5) for c in causes)


def _exceeded_specifications(fit: LinearFit, diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Sources that are larger than stated when all are fitted at once: the sigmas count that in.

    Of curves those that a test has found beyond their linearity: one within it is no fault.
    """
    found: dict[str, Finding] = {}
    fired = {test.code for test in diagnosis.tests if test.fires}
    for larger in exceeded_specifications(fit):
        code = f"VARIANCE_{larger.component.upper()}"
        if larger.component.startswith("curve_") and code not in fired:
            continue
        finding = exceeded(larger, fit.design)
        chance = 1.0 - float(np.exp(larger.log_chance))
        found.setdefault(finding.code, replace(finding, probability=chance))
    return tuple(found.values())[:MOST_SOURCES_REPORTED]


def _unexplained_chi2_per_dof(diagnosis: Diagnosis) -> float:
    """chi2/dof that the best single explanation leaves."""
    if not diagnosis.rounds or diagnosis.rounds[0][0].evidence is None:
        return diagnosis.stated_chi2_per_dof
    found = diagnosis.rounds[0][0].evidence
    return found.chi2 / max(found.dof, 1)


def _screening_causes(
    arm: ArmModel, poses: PoseSet, known: PriorInformation
) -> tuple[Finding, ...]:
    """What needs no test: it was read off the file, or off the geometry."""
    many = len(known.flipped) > FLIPPED_SHARE_REFUSED * len(poses)
    left_out = (known.flipped, known.out_of_range, arm, poses)
    return (
        *(replace(f, blocking=many) for f in excluded_poses(*left_out)),
        *(range_finding(f, poses) for f in out_of_range_besides(*left_out)),
        *second_solution(known.search),
    )


def second_solution(search: GlobalStart | None) -> tuple[Finding, ...]:
    """Return the finding that the poses cannot decide between solutions."""
    if search is None or not search.rivals:
        return ()
    solutions = {"solutions": 1 + len(search.rivals)}
    return (Finding(kind=FindingKind.SECOND_SOLUTION, figures=solutions, blocking=True),)


def _geometry_causes(checks: tuple[SetupCheck, ...]) -> tuple[Finding, ...]:
    """A fixture so mounted that its entries have hardly any unique values (Hayati)."""
    return tuple(
        Finding(
            kind=FindingKind.PARALLEL_AXES,
            joint=c.joint,
            reported=(c.text, c.remedy),
            blocking=c.severity is Severity.REFUSED,
        )
        for c in checks
        if c.kind is CheckKind.AXIS_ANGLE and c.severity is not Severity.OK
    )

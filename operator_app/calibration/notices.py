"""Notices about a calibration, and findings for limits of the procedure that the calibration exceeds."""

from collections.abc import Iterator
from dataclasses import replace

from fixtures.base import CheckKind, Severity
from operator_app.calibration.adjudication import PriorInformation, second_solution
from operator_app.calibration.calibrated_arm import (
    calibrated_arm,
    offsets_not_sought,
    tool_accuracy,
)
from operator_app.calibration.error_model import stated_distances
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.findings import range_finding
from operator_app.calibration.multistart import fixture_elsewhere
from operator_app.calibration.result import Solution
from operator_app.calibration.tool_accuracy import HandAccuracy
from operator_app.config.procedure import AcceptanceLimits
from operator_app.messages.finding import Finding, FindingKind, NamedSize
from operator_app.units import names
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind, is_entry, wrap_angle
from solver.diagnostics.identifiability import Identifiability
from solver.diagnostics.limits import CHI2_NOTICE_PROBABILITY, OFFSET_NOTICE_SIGMAS
from solver.diagnostics.statistics import chi2_probability
from solver.estimators.estimate import Estimate
from solver.estimators.linear_fit import LinearFit

OWN_NOTICE = {
    FindingKind.OUTLIERS,
    FindingKind.POSES_FLIPPED,
    FindingKind.SECOND_SOLUTION,
    FindingKind.POSES_IN_RADIANS,
    FindingKind.POSE_OUT_OF_RANGE,
    FindingKind.OUT_OF_RANGE,
    FindingKind.WHOLE_TURN_OFF,
    FindingKind.SATURATED,
    FindingKind.PARALLEL_AXES,
}
"""Kinds of causes that a separate notice already reports; `with_notices` does not repeat them."""

K = FindingKind


def with_notices(
    solution: Solution,
    experiment: Experiment,
    *,
    stated: LinearFit,
    tested: LinearFit,
    repeats: int,
    known: PriorInformation,
    same: tuple[Finding, ...],
    as_stated: tuple[str, ...],
    limits: AcceptanceLimits,
) -> Solution:
    """Return the solution with the tool position error, all notices in order, and the reasons against acceptance.

    `stated`: fit of all poses at stated variances. `tested`: fit of the poses used for tests.
    `repeats`: number of rows that repeat a pose. `same`: findings of placements that do not differ.
    `as_stated`: parameters known from files, not from the poses.
    """
    arm, adjudication = experiment.arm, solution.adjudication
    accuracy = tool_accuracy(calibrated_arm(solution, arm), arm, as_stated, tested)
    sound = not adjudication.diverged
    rows = {"count": repeats, "of": solution.poses, "distinct": solution.poses - repeats}
    findings = (
        *(_ill_conditioned(solution.identifiability, limits) if sound else (Finding(K.DIVERGED),)),
        *((Finding(K.REPEATED_ROWS, figures=rows),) if repeats else ()),
        *_of_readings(experiment, known, stated, sound=sound),
        *_of_parameters(solution, accuracy, arm, as_stated),
        *_of_the_fit(solution, same, sound=sound),
        *(
            Finding(
                K.RVDT_HARMFUL if v.treat_as_unsensed else K.RVDT_VERDICT,
                joint=v.joint,
                sensor="RVDT",
                names=(v.verdict.value,),
                reported=(v.text,),
            )
            for v in solution.rvdt
        ),
        *(
            c
            for c in adjudication.causes
            if not c.blocking and c.kind not in OWN_NOTICE and c.sensor != "RVDT"
        ),
    )
    exceeded = exceeded_limits(solution.estimate, limits)
    return replace(
        solution,
        accuracy=accuracy,
        warnings=findings,
        reasons=(*adjudication.reasons, *(f.sentence for f in exceeded)),
    )


def _of_readings(
    experiment: Experiment, known: PriorInformation, stated: LinearFit, *, sound: bool
) -> Iterator[Finding]:
    """Yield notices on readings and set-up. `stated`: fit at stated variances. `sound`: solution has not diverged."""
    fixture, poses = experiment.fixture, experiment.poses
    if stated.dof > 0 and chi2_probability(stated.dof, stated.chi2) < CHI2_NOTICE_PROBABILITY:
        yield Finding(K.CHI2_EXCEEDS, size=stated.chi2 / stated.dof)
    for readings in known.out_of_range:
        yield range_finding(readings, experiment, notice=True)
    if poses.endpoint is not None and fixture.kind != "measured":
        yield Finding(K.ENDPOINTS_UNUSED, names=(fixture.kind,))
    measured, used = getattr(fixture, "distances", ()), stated_distances(experiment)
    if unused := tuple(names(d.between) for d in measured if d not in used):
        yield Finding(K.DISTANCE_UNUSED, names=unused, joints=poses.placements)
    for c in known.checks if sound else ():
        if c.severity is not Severity.OK and c.kind is not CheckKind.HIDDEN:
            yield Finding(K.SETUP_CHECK, names=(c.code,), reported=(c.text, c.remedy))
    yield from known.left_out


def _of_parameters(
    solution: Solution, accuracy: HandAccuracy, arm: ArmModel, as_stated: tuple[str, ...]
) -> Iterator[Finding]:
    rates = {h.name: h.rate_m_per_rad for h in accuracy.holds_for}
    if solution.held:
        yield Finding(K.FIXED_UNSEEN, names=solution.held, figures=rates)
    fixed = {f"theta_off_{j}": j for j in offsets_not_sought(solution.model, arm)}
    offsets = tuple(
        NamedSize(name=name, size=float(arm.table.theta_off_rad[j - 1]), unit="rad")
        for name, j in fixed.items()
        if name not in solution.held
    )
    if offsets:
        tolerance = arm.offset_tolerance_rad
        yield Finding(K.FIXED_BY_CHOICE, size=tolerance, unit="rad", sizes=offsets, figures=rates)
    yield from _offsets_beyond_tolerance(solution.estimate, arm)
    units = {p.name: p.unit for p in solution.estimate.parameters}
    sd, shares = solution.estimate.sd_by_name, solution.shares
    sizes = tuple(
        NamedSize(name=n, size=sd.get(n, 0.0), unit=units.get(n, ""), share=shares.get(n, 0.0))
        for n in as_stated
    )
    if sizes:
        yield Finding(K.KNOWN_BY_FILES, sizes=sizes)
    yield from second_solution(solution.search)


def _offsets_beyond_tolerance(estimate: Estimate, arm: ArmModel) -> Iterator[Finding]:
    sigma = arm.offset_tolerance_rad
    for p, x in zip(estimate.parameters, estimate.x.tolist(), strict=True):
        entry = DhEntry.parse(p.name) if is_entry(p.name) else None
        if not sigma or entry is None or entry.kind is not DhKind.THETA_OFF:
            continue
        change = float(wrap_angle(x - p.nominal))
        if abs(change) > OFFSET_NOTICE_SIGMAS * sigma:
            figures = {"times": abs(change) / sigma}
            yield Finding(
                K.OFFSET_FAR,
                joint=entry.row,
                names=(p.name,),
                size=change,
                unit="rad",
                figures=figures,
            )


def _of_the_fit(solution: Solution, same: tuple[Finding, ...], *, sound: bool) -> Iterator[Finding]:
    compliance = None if solution.components is None else solution.components.compliance
    if sound and compliance is not None and compliance.deflects and not solution.tolerated:
        # Errors of link lengths may appear as compliance.
        yield Finding(K.LENGTHS_EXACT)
    yield from same
    if sound:
        yield from fixture_elsewhere(solution.estimate, solution.model)
        # If outliers block acceptance, that cause names them, and the other poses cannot be judged.
        blocked = any(c.kind is K.OUTLIERS and c.blocking for c in solution.causes)
        if solution.outliers and not blocked:
            yield Finding(K.OUTLIERS_COUNT, poses=solution.outliers)


def exceeded_limits(estimate: Estimate, limits: AcceptanceLimits) -> tuple[Finding, ...]:
    """Return a finding for each limit of the procedure that a calibration exceeds."""
    after, turned = estimate.sigmas, estimate.sigmas.orientation_rad
    return tuple(
        Finding(kind, size=value, figures={"limit": limit / per_si}, blocking=True)
        for kind, value, limit, per_si in (
            (K.LIMIT_SIGMA_POS, after.position_m.rms, limits.sigma_pos_mm, 1e3),
            (K.LIMIT_SIGMA_ORI, None if turned is None else turned.rms, limits.sigma_ori_mrad, 1e3),
            (K.LIMIT_CHI2, estimate.chi2_per_dof, limits.chi2_per_dof, 1.0),
        )
        if limit is not None and value is not None and value > limit / per_si
    )


def _ill_conditioned(identified: Identifiability, limits: AcceptanceLimits) -> tuple[Finding, ...]:
    """Return a warning if the condition number exceeds the procedure's limit; this does not affect acceptance."""
    number, limit = identified.scaled_condition_number, limits.scaled_condition_number
    names, figures = identified.weakest.parameters, {"limit": limit}
    condition = Finding(K.CONDITION, names=names, size=number, figures=figures)
    return () if number <= limit else (condition,)

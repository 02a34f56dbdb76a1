"""Notices about a calibration, and the limits of the procedure that it exceeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from fixtures.base import CheckKind, EndpointConstraint, SetupCheck, Severity
from operator_app.calibration.acceptance import Adjudication
from operator_app.calibration.adjudication import PriorInformation, second_solution
from operator_app.calibration.calibrated_arm import (
    calibrated_arm,
    hand_accuracy,
    hand_errors,
    offsets_not_sought,
    with_held,
)
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.findings import excluded_poses, out_of_range_besides, range_finding
from operator_app.calibration.multistart import socket_elsewhere
from operator_app.calibration.placements import IndistinguishablePlacements, contradicted
from operator_app.calibration.result import Solution
from operator_app.calibration.tool_accuracy import HandAccuracy
from operator_app.config.procedure import AcceptanceLimits
from operator_app.messages.finding import Finding, FindingKind, NamedSize
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics.identifiability import Identifiability
from solver.diagnostics.limits import CHI2_NOTICE_PROBABILITY
from solver.estimators.estimate import Estimate
from solver.estimators.variance_components import Calibrated, VarianceComponents

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
"""Causes that have their own notice."""

K = FindingKind


def with_notices(
    solution: Solution,
    experiment: Experiment,
    *,
    whole: Calibrated,
    judged: Calibrated,
    known: PriorInformation,
    same: tuple[IndistinguishablePlacements, ...],
    as_stated: tuple[str, ...],
    adjudication: Adjudication,
    limits: AcceptanceLimits,
) -> Solution:
    """Add the accuracy of the tool, the verdict, and all notices in order.

    `whole` is the fit of all poses, `judged` that of the tested ones; `as_stated` are parameters known from the files
    rather than from the poses.
    """
    arm, poses = experiment.arm, experiment.poses
    found_arm = calibrated_arm(solution, arm)
    errors_there = hand_errors(found_arm, arm)
    accuracy = with_held(
        hand_accuracy(errors_there, found_arm, arm, as_stated),
        errors_there.after_m, found_arm, arm, judged.linear,
    )  # fmt: skip
    # Parameters dropped on request have their own notice.
    not_sought = tuple(
        j for j in offsets_not_sought(solution.model, arm) if f"theta_off_{j}" not in solution.held
    )
    left_out = (solution.dropped_flipped, known.out_of_range, arm, poses)
    sound = not adjudication.diverged
    found = (
        *(() if sound else (Finding(kind=K.DIVERGED),)),
        *_excess_noise(whole.linear.stated.chi2, whole.linear.dof),
        *(range_finding(f, poses, notice=True) for f in out_of_range_besides(*left_out)),
        *_unused_endpoints(experiment.fixture, poses),
        *(_setup_findings(known.checks) if sound else ()),
        *excluded_poses(*left_out),
        *_fixed_unseen(solution.held, accuracy),
        *_fixed_by_choice(not_sought, accuracy, arm),
        *_known_by_files(as_stated, solution.estimate, solution.shares),
        *second_solution(solution.search),
        *(_lengths_exact(solution.components, solution.tolerated) if sound else ()),
        *(_same_placement(a) for a in same),
        *(
            Finding(
                kind=K.DISTANCE_ABOVE if d.deviation > 0.0 else K.DISTANCE_BELOW,
                joints=d.between,
                figures={"sigmas": abs(d.deviation)},
            )
            for d in contradicted(solution.distances)
        ),
        *(socket_elsewhere(solution.estimate) if sound else ()),
        *(outliers_still_used(solution.outliers) if sound else ()),
        *(
            Finding(
                kind=K.RVDT_HARMFUL if v.treat_as_unsensed else K.RVDT_VERDICT,
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
        *(_ill_conditioned(solution.seen, limits) if sound else ()),
    )
    exceeded = exceeded_limits(solution.estimate, limits)
    return replace(
        solution,
        accuracy=accuracy,
        warnings=found,
        adjudication=adjudication,
        reasons=(*adjudication.reasons, *(f.sentence for f in exceeded)),
    )


def exceeded_limits(estimate: Estimate, limits: AcceptanceLimits) -> tuple[Finding, ...]:
    """Return which of the procedure's own limits a calibration exceeds."""
    after, turned = estimate.sigmas, estimate.sigmas.orientation_rad
    return tuple(
        Finding(kind=kind, size=found, figures={"limit": limit}, blocking=True)
        for kind, found, limit in (
            (K.LIMIT_SIGMA_POS, after.position_m.rms, limits.sigma_pos_m),
            (K.LIMIT_SIGMA_ORI, None if turned is None else turned.rms, limits.sigma_ori_rad),
            (K.LIMIT_CHI2, estimate.chi2_per_dof, limits.chi2_per_dof),
        )
        if limit is not None and found is not None and found > limit
    )


def outliers_still_used(labels: tuple[str, ...]) -> tuple[Finding, ...]:
    """Return the finding that some used poses do not fit the others."""
    return (Finding(kind=K.OUTLIERS_COUNT, poses=labels),) if labels else ()


def _setup_findings(checks: tuple[SetupCheck, ...]) -> tuple[Finding, ...]:
    """Warnings of the fixture's set-up checks at the identified parameters."""
    return tuple(
        Finding(kind=K.SETUP_CHECK, names=(c.code,), reported=(c.text, c.remedy))
        for c in checks
        if c.severity is not Severity.OK and c.kind is not CheckKind.HIDDEN
    )


def _unused_endpoints(fixture: EndpointConstraint, poses: PoseSet) -> tuple[Finding, ...]:
    if poses.endpoint is None or fixture.kind == "measured":
        return ()
    return (Finding(kind=K.ENDPOINTS_UNUSED, names=(fixture.kind,)),)


def _excess_noise(chi2: float, dof: int) -> tuple[Finding, ...]:
    """Return the finding that stated noise does not explain the misfit: `chi2` is at stated variances."""
    from scipy.special import chdtrc

    if dof <= 0 or float(chdtrc(dof, chi2)) >= CHI2_NOTICE_PROBABILITY:
        return ()
    return (Finding(kind=K.CHI2_EXCEEDS, size=chi2 / dof),)


def _rates(accuracy: HandAccuracy) -> dict[str, float]:
    return {h.name: h.rate_m_per_rad for h in accuracy.holds_for}


def _fixed_unseen(held: tuple[str, ...], accuracy: HandAccuracy) -> tuple[Finding, ...]:
    """Return the finding of parameters dropped on request."""
    if not held:
        return ()
    return (Finding(kind=K.FIXED_UNSEEN, names=held, figures=_rates(accuracy)),)


def _fixed_by_choice(
    joints: tuple[int, ...], accuracy: HandAccuracy, arm: ArmModel
) -> tuple[Finding, ...]:
    """Return the finding of offsets that the procedure or the arm's file fixes."""
    if not joints:
        return ()
    offsets = arm.table.theta_off_rad
    sizes = tuple(
        NamedSize(name=f"theta_off_{j}", size=float(offsets[j - 1]), unit="rad") for j in joints
    )
    return (
        Finding(
            kind=K.FIXED_BY_CHOICE,
            size=arm.offset_tolerance_rad,
            unit="rad",
            sizes=sizes,
            figures=_rates(accuracy),
        ),
    )


def _known_by_files(
    by_files: tuple[str, ...], estimate: Estimate, shares: Mapping[str, float]
) -> tuple[Finding, ...]:
    """Return the parameters determined more by the files than by the poses, with the files' uncertainty."""
    known = {
        p.name: (float(sd), p.unit)
        for p, sd in zip(estimate.parameters, estimate.standard_deviation, strict=True)
    }
    sizes = []
    for name in by_files:
        size, unit = known.get(name, (0.0, ""))
        sizes.append(NamedSize(name=name, size=size, unit=unit, share=shares.get(name, 0.0)))
    return (Finding(kind=K.KNOWN_BY_FILES, sizes=tuple(sizes)),) if sizes else ()


def _lengths_exact(
    components: VarianceComponents | None, tolerated: tuple[str, ...]
) -> tuple[Finding, ...]:
    """Return the finding that an apparent compliance may be errors of link lengths."""
    if components is None or tolerated:
        return ()
    if components.compliance is None or not components.compliance.gives:
        return ()
    return (Finding(kind=K.LENGTHS_EXACT),)


def _same_placement(found: IndistinguishablePlacements) -> Finding:
    """Return the finding of placements that are identical, and count as one."""
    return Finding(
        kind=K.SAME_PLACEMENT,
        joints=found.numbers,
        names=(found.parameter.name,),
        size=found.difference,
        unit=found.parameter.unit,
        figures={"sigmas": found.sigmas},
    )


def _ill_conditioned(seen: Identifiability, limits: AcceptanceLimits) -> tuple[Finding, ...]:
    """Return a warning if the condition number exceeds the paper's limit; acceptance goes by the sigmas."""
    if seen.scaled_condition_number <= limits.scaled_condition_number:
        return ()
    return (
        Finding(
            kind=K.CONDITION,
            names=seen.weakest.parameters,
            size=seen.scaled_condition_number,
            figures={"limit": limits.scaled_condition_number},
        ),
    )

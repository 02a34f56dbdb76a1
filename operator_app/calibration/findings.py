"""Findings of fitted faults, of poses that were left out, and of motion during sampling."""

from dataclasses import replace

import numpy as np

from operator_app.calibration.experiment import Experiment
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.sensors import Encoder, Rvdt
from solver.diagnostics.fault_models import Cause, FaultModels
from solver.diagnostics.limits import MOTION_SPREAD_RAD, MOTION_SPREAD_SIGMAS
from solver.diagnostics.model_selection import Explanation
from solver.diagnostics.range_checks import RangeFinding, ReadingFault, rows_in_radians
from solver.diagnostics.stated_sizes import ExceededSpecification, exceeded_specifications
from solver.estimators.effects import LinearModel
from solver.estimators.variance_components import Calibrated
from solver.loops.endpoints import MeasuredClosure

RESTARTED_RAD = np.deg2rad(5.0)
"""A larger step is not a count loss but a restarted node, which counts from another zero."""

RANGE_KINDS = {
    ReadingFault.OUTSIDE: (FindingKind.OUT_OF_RANGE, FindingKind.OUT_OF_RANGE_NOTICE),
    ReadingFault.WHOLE_TURN: (FindingKind.WHOLE_TURN_OFF, FindingKind.WHOLE_TURN_OFF_NOTICE),
    ReadingFault.SATURATED: (FindingKind.SATURATED, FindingKind.SATURATED_NOTICE),
}
"""Two kinds of finding for each fault: a cause of the verdict (code with the joint), and a notice (without joint)."""

EXCEEDED_KINDS = {
    "rvdt": FindingKind.RVDT_NOISE_EXCEEDS,
    "curve": FindingKind.RVDT_LINEARITY_EXCEEDS,
    "gain": FindingKind.RVDT_GAIN_EXCEEDS,
    "lengths": FindingKind.LENGTHS_EXCEED,
    "twists": FindingKind.TWISTS_EXCEED,
    "encoder": FindingKind.ENCODERS_EXCEED,
    "joint": FindingKind.PLAY_EXCEEDS,
}
"""Kinds of finding by the first word of a variance component's name."""


def pose_labels(poses: PoseSet) -> tuple[str, ...]:
    """Labels of poses, with the placement number if there are several placements."""
    if len(poses.placements) == 1:
        return poses.label
    return tuple(
        f"{label} of placement {number}"
        for label, number in zip(poses.label, poses.placement, strict=True)
    )


INSTRUMENT_KINDS = {
    FindingKind.FIXTURE_DEFLECTS_MORE: FindingKind.INSTRUMENT_DEFLECTS_MORE,
    FindingKind.FIXTURE_DEFLECTS_OTHERWISE: FindingKind.INSTRUMENT_DEFLECTS_OTHERWISE,
    FindingKind.FIXTURE_TURNS_RANDOMLY: FindingKind.INSTRUMENT_TURNS_RANDOMLY,
    FindingKind.FIXTURE_SHIFTS_RANDOMLY: FindingKind.INSTRUMENT_SHIFTS_RANDOMLY,
}
"""For kinds of finding about a fixture, the kinds that replace them if an instrument measures the tool."""


def _measured(design: LinearModel) -> bool:
    """Return whether an instrument measures the tool, instead of a fixture constraining it."""
    return isinstance(design.model.parts()[0][0], MeasuredClosure)


def finding_of(x: Explanation, faults: FaultModels, labels: tuple[str, ...]) -> Finding:
    """Return the finding that reports a fitted fault; `labels`: names of the poses in order of time."""
    return replace(_described(x, faults, labels), probability=x.probability)


def _described(x: Explanation, faults: FaultModels, labels: tuple[str, ...]) -> Finding:
    K, candidate, subject = FindingKind, x.candidate, x.candidate.subject
    poses = tuple(labels[k] for k in candidate.poses)
    first, measured = float(x.b[0]), _measured(faults.design)
    match candidate.cause:
        case Cause.SLIPPED:
            side = "table" if subject == "table" else "tool"
            kind = K.FIXTURE_SLIPPED
            if measured:
                kind = K.INSTRUMENT_MOVED if side == "table" else K.TARGET_MOVED
            size = rms_displacement(x, faults)
            between = _between(candidate.poses[0], labels)
            return Finding(kind, names=(side,), poses=between, figures=size)
        case Cause.LOST_COUNTS:
            step = reading_step(int(subject), first, candidate.poses[0], faults.arm, labels)
            # A target that turns about the last joint's axis looks like a step of that joint's reading.
            ambiguous = measured and step.joint == faults.design.model.joint_count
            return replace(step, kind=K.READING_OR_TARGET_STEP) if ambiguous else step
        case Cause.LENGTH_CHANGED:
            between = _between(candidate.poses[0], labels)
            return Finding(K.LENGTH_STEP, names=(subject,), poses=between, size=first, unit="m")
        case Cause.OUTLIERS:
            return Finding(K.OUTLIERS, poses=poses)
        case Cause.FROZEN:
            return Finding(K.READING_FROZEN, joint=int(subject), poses=poses)
        case Cause.READING:
            return _reading_noise(int(subject), x, faults)
        case Cause.SCATTER:
            # The prior shrinks coefficients where the poses have little information: the shrinkage is corrected.
            predicted = float((1.0 - x.covariance / (x.size * candidate.expected_size) ** 2).sum())
            rms = float(np.sqrt(x.b @ x.b / max(predicted, 1.0)))
            return Finding(K.ALL_READINGS_NOISE, size=rms, unit="rad")
        case Cause.SCALE:
            return Finding(K.ENCODER_SCALE, joint=int(subject), size=first)
        case Cause.DRIFT:
            return Finding(K.READING_DRIFT, joint=int(subject), size=first, unit="rad")
        case Cause.LENGTH | Cause.TWIST:
            return _entry(x, faults)
        case Cause.GIVES:
            size, errors = rms_displacement(x, faults), faults.design.errors
            stated = {"turn_rad": errors.give_rad or 0.0, "shift_m": errors.give_m or 0.0}
            more = any(size[k] > np.sqrt(3.0) * stated[k] for k in size)
            kind = K.FIXTURE_DEFLECTS_MORE if more else K.FIXTURE_DEFLECTS_OTHERWISE
            return Finding(INSTRUMENT_KINDS[kind] if measured else kind, figures=size)
        case _:
            return _smooth(int(subject), x, faults)


def exceeded(larger: ExceededSpecification, design: LinearModel) -> Finding:
    """Return the finding that one source of error exceeds its specification."""
    name, _, which = larger.component.partition("_")
    figures = {"times": larger.times}
    if name == "fixture":
        turns = which == "rad"
        stated = design.errors.give_rad if turns else design.errors.give_m
        kind = FindingKind.FIXTURE_TURNS_RANDOMLY if turns else FindingKind.FIXTURE_SHIFTS_RANDOMLY
        return Finding(
            INSTRUMENT_KINDS[kind] if _measured(design) else kind,
            size=larger.times * (stated or 0.0),
            unit="rad" if turns else "m",
            figures=figures,
        )
    of_rvdt = name in ("rvdt", "curve", "gain")
    return Finding(
        EXCEEDED_KINDS.get(name, FindingKind.SAG_EXCEEDS),
        joint=int(which) if of_rvdt else 0,
        sensor="RVDT" if of_rvdt else "",
        figures=figures,
    )


def exceeded_source(calibrated: Calibrated, name: str) -> str:
    """Return a parameter's main source of error if that source exceeds its specification; otherwise "".

    A main source contributes more than half of the variance. Without one, only more varied poses would help.
    """
    budget, names = calibrated.components.budget, [p.name for p in calibrated.estimate.parameters]
    if not budget or name not in names:
        return ""
    k = names.index(name)
    source = max(budget, key=lambda s: float(budget[s][k]))
    if not 2.0 * float(budget[source][k]) > float(calibrated.estimate.covariance[k, k]):
        return ""
    larger = {x.component for x in exceeded_specifications(calibrated.linear)}
    sources = {c.source for c in calibrated.linear.design.components if c.name in larger}
    return source if source in sources else ""


def sensor_name(joint: int, arm: ArmModel) -> str:
    """Return the name of a joint's sensor as it appears in the codes of findings."""
    return "RVDT" if isinstance(arm.joints[joint - 1].sensor, Rvdt) else "ENCODER"


def reading_step(
    joint: int, step_rad: float, first: int, arm: ArmModel, labels: tuple[str, ...]
) -> Finding:
    """Return the finding that a joint's readings shift by `step_rad` from pose `first` on (index in time order)."""
    sensor = arm.joints[joint - 1].sensor
    figures = {}
    if isinstance(sensor, Encoder | Rvdt):
        counted = "counts" if isinstance(sensor, Encoder) else "lsb"
        figures = {counted: step_rad / sensor.resolution_rad}
    jump = abs(step_rad) > RESTARTED_RAD
    return Finding(
        FindingKind.READING_JUMP if jump else FindingKind.READING_STEP,
        joint=joint,
        poses=_between(first, labels),
        size=step_rad,
        unit="rad",
        figures=figures,
    )


def range_finding(
    out_of_range: RangeFinding, experiment: Experiment, *, notice: bool = False
) -> Finding:
    """Return the finding of readings out of range. Saturated readings block acceptance, but a `notice` never does."""
    j, where, poses = out_of_range.joint, out_of_range.poses, experiment.poses
    joint = experiment.arm.joints[j - 1]
    return Finding(
        RANGE_KINDS[out_of_range.fault][notice],
        joint=j,
        poses=tuple(poses.label[k] for k in where),
        size=float(poses.q_rad[where[0], j - 1]),
        unit="rad",
        figures={"lower_rad": joint.lower_rad, "upper_rad": joint.upper_rad},
        blocking=out_of_range.fault is ReadingFault.SATURATED and not notice,
    )


def _between(first: int, labels: tuple[str, ...]) -> tuple[str, str]:
    return labels[first - 1], labels[first]


def _reading_noise(joint: int, x: Explanation, faults: FaultModels) -> Finding:
    arm, sd = faults.arm, _rms(x.b)
    shares = [float(np.median(a.share)) for a in faults.design.errors.analogue if a.joint == joint]
    samples = round(1.0 / shares[0]) if shares else 1
    stated = float(np.sqrt(arm.joints[joint - 1].sensor.variance_of_mean_rad2(samples)))
    return Finding(
        FindingKind.READING_NOISE,
        joint=joint,
        sensor=sensor_name(joint, arm),
        size=sd,
        unit="rad",
        figures={"times": sd / stated},
    )


def _entry(x: Explanation, faults: FaultModels) -> Finding:
    design, name = faults.design, x.candidate.subject
    k = [p.name for p in design.model.parameters].index(name)
    stated = float(design.prior_sd[list(design.prior_index).index(k)])
    angle = x.candidate.cause is Cause.TWIST
    return Finding(
        FindingKind.TWIST_OFF if angle else FindingKind.LENGTH_OFF,
        names=(name,),
        # The residual is w + A dx, so that the coefficient has the opposite sign of the error.
        size=-float(x.b[0]),
        unit="rad" if angle else "m",
        figures={"limit": stated},
    )


def _smooth(joint: int, x: Explanation, faults: FaultModels) -> Finding:
    candidate = x.candidate
    if candidate.cause is Cause.CURVE:
        sensor = faults.arm.joints[joint - 1].sensor
        peak, sd, from_line = candidate.deviation(x.b, x.covariance)
        figures = {"from_line": 1.0} if from_line else {}
        if isinstance(sensor, Rvdt):
            figures |= {"full_scale_rad": sensor.full_scale_rad, "linearity": sensor.linearity}
        return Finding(
            FindingKind.RVDT_NONLINEAR,
            joint=joint,
            sensor="RVDT",
            size=peak,
            sigma=sd,
            unit="rad",
            figures=figures,
        )
    # Rotation of the joint (rms over the poses, rad) that comes closest to the explanation's closure error.
    B = faults.system.B[:, :, joint - 1]
    displacement = candidate.moves(x.b, len(B))
    along = (displacement * B).sum(-1) / np.maximum((B**2).sum(-1), 1e-300)
    cyclic = candidate.cause is Cause.TURN_ERROR
    return Finding(
        FindingKind.ENCODER_CYCLIC_ERROR if cyclic else FindingKind.JOINT_SAG,
        joint=joint,
        sensor="ENCODER" if cyclic else "",
        size=_rms(along),
        unit="rad",
    )


def rms_displacement(x: Explanation, faults: FaultModels) -> dict[str, float]:
    """Return the fixture's rms rotation (`turn_rad`) and displacement (`shift_m`) due to the fault `x`.

    The rms is over the poses that the fault affects, in the placement with the largest displacement.
    """
    displacement = x.candidate.moves(x.b, len(faults.system.w))
    along_fixture = (faults.system.E @ displacement[..., None])[..., 0]
    concerned = np.abs(displacement).sum(-1) > 0.0
    group = np.zeros(len(concerned), dtype=np.int64)
    if faults.design.group is not None:
        group = faults.design.group[faults.order]
    sizes = []
    for placement in np.unique(group[concerned]):
        moved = along_fixture[concerned & (group == placement)]
        turn_rad = _rms_length(moved[:, :-3]) if moved.shape[1] > 3 else 0.0
        sizes.append({"turn_rad": turn_rad, "shift_m": _rms_length(moved[:, -3:])})
    return max(sizes, key=lambda size: (size["shift_m"], size["turn_rad"]))


def _rms_length(vectors: FloatArray) -> float:
    return float(np.sqrt((vectors**2).sum(-1).mean()))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.asarray(values) ** 2)))


def motion_causes(experiment: Experiment, labels: tuple[str, ...]) -> tuple[Finding, ...]:
    """Return a finding for each joint whose samples within a pose spread by more than its sensor's noise.

    An RVDT that is noisy in most poses is reported by its RVDT verdict instead. If the arm moves during sampling, the
    mean of the samples does not belong to a closed loop, even if the fit is good.
    """
    arm, sd_rad = experiment.arm, experiment.poses.sd_rad
    if sd_rad is None:
        return ()
    findings = []
    for j, joint in enumerate(arm.joints, 1):
        if not isinstance(joint.sensor, Encoder | Rvdt) or j in experiment.unsensed:
            continue
        spread = sd_rad[:, j - 1]
        has_moved = spread > motion_limit_rad(joint.sensor, spread)
        moved_poses = tuple(int(k) for k in np.argsort(-spread, kind="stable") if has_moved[k])
        if moved_poses:
            findings.append(
                Finding(
                    FindingKind.MOTION_DURING_SAMPLING,
                    joint=j,
                    sensor=sensor_name(j, arm),
                    poses=tuple(labels[k] for k in moved_poses),
                    size=float(spread[moved_poses[0]]),
                    unit="rad",
                )
            )
    return tuple(findings)


def motion_limit_rad(sensor: Encoder | Rvdt, spread_rad: FloatArray) -> float:
    """Return the largest spread of a pose's readings, rad, that this sensor's noise explains.

    For an RVDT, the noise is the median of `spread_rad` (m,) over the poses if this is larger than the stated noise.
    """
    noise = sensor.sigma_rad
    if isinstance(sensor, Rvdt):
        noise = max(noise, float(np.median(spread_rad)))
    return float(max(MOTION_SPREAD_SIGMAS * noise, MOTION_SPREAD_RAD))


WRONG_ROW_JOINTS = 3
"""This many joints outside their ranges indicate a wrong row in the file; fewer may be due to a tool upside down."""


def left_out_poses(
    left_out: tuple[int, ...], out_of_range: tuple[RangeFinding, ...], arm: ArmModel, poses: PoseSet
) -> tuple[tuple[Finding, ...], tuple[RangeFinding, ...]]:
    """Return findings that state why poses were left out, and the part of `out_of_range` still to be reported.

    `left_out`: indices of the left-out poses. A range finding is not reported if all its poses were left out because
    they are in radians.
    """
    joints = {
        k: [f.joint for f in out_of_range if f.fault is ReadingFault.OUTSIDE and k in f.poses]
        for k in left_out
    }
    radians = set(rows_in_radians(arm, poses.q_rad)) & set(left_out) if left_out else set()
    wrong = tuple(k for k in left_out if len(joints[k]) >= WRONG_ROW_JOINTS and k not in radians)
    flipped = tuple(k for k in left_out if len(joints[k]) < WRONG_ROW_JOINTS and k not in radians)
    findings = []
    if radians:
        labels = tuple(poses.label[k] for k in sorted(radians))
        findings.append(Finding(FindingKind.POSES_IN_RADIANS, poses=labels))
    findings.extend(
        Finding(FindingKind.POSE_OUT_OF_RANGE, poses=(poses.label[k],), joints=tuple(joints[k]))
        for k in wrong
    )
    if flipped:
        findings.append(
            Finding(
                FindingKind.POSES_FLIPPED,
                poses=tuple(poses.label[k] for k in flipped),
                figures={"count": len(flipped), "of": len(poses)},
            )
        )
    return tuple(findings), tuple(f for f in out_of_range if not radians.issuperset(f.poses))

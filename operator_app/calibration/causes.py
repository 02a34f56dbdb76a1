"""What may be wrong, in words: a figure with its unit, and what to do about it. Judges nothing itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from operator_app.units.figure import (
    ANGLE_TOLERANCE,
    GIVES_ANGLE,
    GIVES_LENGTH,
    GREW,
    LENGTH_TOLERANCE,
    LINEARITY,
    LOST_COUNTS,
    LOST_LSB,
    MANY_TIMES,
    OF_FULL_SCALE,
    OFF_LENGTH,
    OFF_SCALE,
    SCATTER,
    SHIFTED,
    STEP,
    STRAY,
    TARGET,
    TIMES,
    TURNED,
)
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder, Rvdt
from solver.diagnostics.fault_candidate import Candidate, Cause
from solver.diagnostics.fault_models import FaultModels
from solver.diagnostics.model_selection import Evidence
from solver.diagnostics.stated_sizes import ExceededSpecification
from solver.estimators.effects import LinearModel

NAMED = 5
"""How many poses a sentence lists by name."""

RESTARTED_RAD = np.deg2rad(5.0)
"""No slip of a count is this large: a node that restarted counts from another zero."""


class Words(NamedTuple):
    """A stable code, what is the matter, and what to do."""

    code: str
    text: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedCause:
    """One cause as the operator reads it.

    Attributes
    ----------
    code
        Stable name.
    probability
        Against all other explanations that were weighed, "nothing wrong" among them.
    refuses
        Whether parameters found in spite of it may be wrong by more than they claim.
    """

    code: str
    probability: float
    text: str
    remedy: str
    refuses: bool


def in_words(
    candidate: Candidate, found: Evidence, scene: FaultModels, labels: tuple[str, ...]
) -> Words:
    """Return code, text and remedy; `labels` name the poses in the order in which they were taken."""
    subject = candidate.subject
    match candidate.cause:
        case Cause.SLIPPED:
            return _slipped(candidate, found, scene, labels)
        case Cause.LOST_COUNTS:
            return shift_in_words(
                int(subject), float(found.b[0]), candidate.poses[0], scene.arm, labels
            )
        case Cause.LENGTH_CHANGED:
            return Words(
                f"STEP_LENGTH_{subject}",
                f"{subject} changed by {GREW.not_zero(float(found.b[0])).with_unit} {_between(candidate, labels)}",
                f"look for a loose joint or link at {subject}, then take all poses again",
            )
        case Cause.OUTLIERS:
            several = len(candidate.poses) > 1
            return Words(
                "OUTLIERS",
                f"{poses_named(candidate.poses, labels)} "
                f"{'do' if several else 'does'} not fit the others",
                f"look for what disturbed {'them' if several else 'it'}, exclude "
                f"{'them' if several else 'it'} and calibrate again",
            )
        case Cause.FROZEN:
            return frozen_in_words(int(subject), candidate.poses, labels)
        case Cause.READING:
            return _reading(int(subject), found, scene)
        case Cause.SCATTER:
            return _scatter(candidate, found)
        case Cause.SCALE:
            off = OFF_SCALE.not_zero(float(found.b[0])).with_unit
            return Words(
                f"SCALE_{subject}",
                f"the scale of joint {subject}'s encoder is off by about {off}",
                f"check counts_per_rev and the gear of joint {subject} in arm file and drive, then take all "
                "poses again",
            )
        case Cause.DRIFT:
            return Words(
                f"DRIFT_JOINT_{subject}",
                f"the reading of joint {subject} drifts by about {STEP.not_zero(float(found.b[0])).with_unit} from the "
                "first pose to the last",
                f"let arm and electronics warm up, check the coupling of joint {subject}'s sensor, then take "
                "all poses again",
            )
        case Cause.LENGTH | Cause.TWIST:
            return _entry(candidate, found, scene)
        case Cause.GIVES:
            size = rms_displacement(candidate, found, scene)
            stated = (scene.design.errors.give_rad or 0.0, scene.design.errors.give_m or 0.0)
            more = any(one > np.sqrt(3.0) * known for one, known in zip(size, stated, strict=True))
            return Words(
                "FIXTURE_GIVES",
                f"the fixture gives about {_displacement(size)}, "
                + (
                    "more than its file states" if more else "and not as load or pose would have it"
                ),
                "tighten its bolts and look for play; else state its give in the fixture file",
            )
        case _:
            return _smooth(int(subject), candidate, found, scene)


def larger_in_words(found: ExceededSpecification, design: LinearModel) -> Words:
    """Say that a source of error is larger than its statement, one of several that are."""
    kind, _, which = found.component.partition("_")
    times = TIMES(found.times).shown
    size = f"about {times} times what "
    match kind:
        case "fixture":
            stated = design.errors.give_rad if which == "rad" else design.errors.give_m
            kind_of = GIVES_ANGLE if which == "rad" else GIVES_LENGTH
            gives = kind_of(found.times * (stated or 0.0)).with_unit
            return Words(
                "FIXTURE_GIVES",
                f"the fixture {'turns' if which == 'rad' else 'shifts'} by about {gives} anew in every "
                f"pose, {times} times what its file states",
                "tighten its bolts and look for play; else state its give in the fixture file",
            )
        case "rvdt":
            return Words(
                f"RVDT_{which}",
                f"readings of joint {which}'s RVDT scatter {size}its specification says",
                f"check its plug, screen and excitation, or calibrate with --unsensed {which}",
            )
        case "curve":
            return Words(
                f"RVDT_{which}",
                f"the curve of joint {which}'s RVDT is {size}its specification says",
                f"have it replaced or linearised, or calibrate with --unsensed {which}",
            )
        case "gain":
            return Words(
                f"RVDT_{which}",
                f"the gain of joint {which}'s RVDT is off by {size}its specification says",
                f"have its scale factor set or state its gain, or calibrate with --unsensed {which}",
            )
        case "lengths" | "twists":
            return Words(
                kind.upper(),
                f"the arm's {kind} are off its file by {size}the file's tolerance says",
                f"measure the arm and correct the file, or state a larger tolerance for its {kind}",
            )
        case "encoder":
            return Words(
                "ENCODERS",
                f"the encoders err by {size}the arm file states",
                "check how they are centred, or state their accuracy_deg",
            )
        case _:
            word = "play" if kind == "joint" else "sag under load"
            return Words(
                "PLAY" if kind == "joint" else "SAG",
                f"the joints' {word} is {size}the arm file states",
                f"look for worn bearings and couplings, or state the joints' {word}",
            )


def poses_named(poses: tuple[int, ...], labels: tuple[str, ...]) -> str:
    """``pose 4`` or ``poses 4, 7 and 3 more``."""
    named = [labels[k] for k in poses[:NAMED]]
    rest = len(poses) - len(named)
    more = f" and {rest} more" if rest else ""
    return f"pose{'s' if len(poses) > 1 else ''} {', '.join(named)}{more}"


def frozen_in_words(joint: int, poses: tuple[int, ...], labels: tuple[str, ...]) -> Words:
    """Say that a sensor did not follow its joint."""
    return Words(
        f"FROZEN_JOINT_{joint}",
        f"the sensor of joint {joint} reads the same from pose {labels[poses[0]]} to pose "
        f"{labels[poses[-1]]}, where the loop says that the joint moved",
        f"check the sensor and cable of joint {joint}, then take these poses again; "
        f"or calibrate with --unsensed {joint}",
    )


def wrong_reading(joint: int, arm: ArmModel) -> Words:
    """Say that a joint's reading has nothing to do with its angle."""
    return Words(
        _sensor_code(joint, arm),
        f"the reading of joint {joint} does not follow the joint's angle as the loop measures it",
        f"check the sensor, cable and channel of joint {joint}; meanwhile calibrate with "
        f"--unsensed {joint}",
    )


def _sensor_code(joint: int, arm: ArmModel) -> str:
    rvdt = isinstance(arm.joints[joint - 1].sensor, Rvdt)
    return f"{'RVDT' if rvdt else 'ENCODER'}_{joint}"


def _between(candidate: Candidate, labels: tuple[str, ...]) -> str:
    first = candidate.poses[0]
    return f"between pose {labels[first - 1]} and pose {labels[first]}"


def _slipped(
    candidate: Candidate, found: Evidence, scene: FaultModels, labels: tuple[str, ...]
) -> Words:
    side = candidate.subject
    size = _displacement(rms_displacement(candidate, found, scene))
    where = "on the table" if side == "table" else "on the hand"
    return Words(
        "SLIP_FIXTURE",
        f"the fixture slipped {where} by about {size} {_between(candidate, labels)}",
        f"tighten it {where} and take all poses again, or use only those before or after pose "
        f"{labels[candidate.poses[0]]}",
    )


def shift_in_words(
    joint: int, step_rad: float, first: int, arm: ArmModel, labels: tuple[str, ...]
) -> Words:
    """Say that a joint's reading shifted by `step_rad` from pose `first` (index in time order) on."""
    sensor = arm.joints[joint - 1].sensor
    counts = ""
    if isinstance(sensor, Encoder | Rvdt):
        lost = LOST_COUNTS if isinstance(sensor, Encoder) else LOST_LSB
        counts = f" ({lost.not_zero(step_rad / sensor.resolution_rad).with_unit})"
    where = f"between pose {labels[first - 1]} and pose {labels[first]}"
    if abs(step_rad) > RESTARTED_RAD:
        return Words(
            f"STEP_JOINT_{joint}",
            f"the reading of joint {joint} jumped by {TARGET(step_rad).with_unit}{counts} {where}: "
            "its node restarted or its sensor came off",
            f"home joint {joint} and take all poses again",
        )
    return Words(
        f"STEP_JOINT_{joint}",
        f"the reading of joint {joint} shifted by {STEP.not_zero(step_rad).with_unit}{counts} {where}",
        f"check the coupling and cable of joint {joint}'s sensor (lost counts, a slipped coupling), "
        "home the joint and take all poses again",
    )


def _reading(joint: int, found: Evidence, scene: FaultModels) -> Words:
    """Say how much a joint's readings, which are means of samples, scatter from pose to pose."""
    arm, sd = scene.arm, _rms(found.b)
    shares = [float(np.median(a.share)) for a in scene.design.errors.analogue if a.joint == joint]
    samples = round(1.0 / shares[0]) if shares else 1
    sensor = arm.joints[joint - 1].sensor
    spec = ""
    if isinstance(sensor, Encoder | Rvdt):
        stated = np.sqrt(sensor.variance_of_mean_rad2(samples))
        spec = f", {MANY_TIMES(sd / stated).shown} times its specification"
    return Words(
        _sensor_code(joint, arm),
        f"the reading of joint {joint} scatters by {SCATTER.not_zero(sd).with_unit}{spec}",
        f"check the sensor and cable of joint {joint}, or calibrate with --unsensed {joint}",
    )


def _scatter(candidate: Candidate, found: Evidence) -> Words:
    """Say by how much all readings scatter from pose to pose."""
    # Coefficients are shrunk by as much as the poses leave them open: the share that these do tell counts.
    told = float((1.0 - found.covariance / (found.size * candidate.natural) ** 2).sum())
    size = SCATTER.not_zero(float(np.sqrt(found.b @ found.b / max(told, 1.0)))).with_unit
    return Words(
        "SCATTER",
        f"the readings of all joints scatter by about {size} from pose to "
        "pose, more than their sensors do: vibration, play, or an arm that had not settled",
        "wait longer before a pose is taken and average more samples, look for vibration and loose "
        "couplings, then take all poses again",
    )


def _entry(candidate: Candidate, found: Evidence, scene: FaultModels) -> Words:
    design, name = scene.design, candidate.subject
    k = [p.name for p in design.model.parameters].index(name)
    stated = float(design.soft_sd[list(design.soft_index).index(k)])
    angle = candidate.cause is Cause.TWIST
    # Fitted columns act against the parameter: w + A dx is what is left.
    off = -float(found.b[0])
    size = (TARGET if angle else OFF_LENGTH).not_zero(off).with_unit
    tolerance = (ANGLE_TOLERANCE if angle else LENGTH_TOLERANCE)(stated).with_unit
    return Words(
        f"TWIST_{name}" if angle else f"LENGTH_{name}",
        f"{name} is off the arm file by about {size}, where its tolerance is {tolerance}",
        f"measure {name} and correct the arm file, or state a larger tolerance for its row",
    )


def _smooth(joint: int, candidate: Candidate, found: Evidence, scene: FaultModels) -> Words:
    size = SCATTER.not_zero(_rms_along(joint, candidate, found, scene)).with_unit
    match candidate.cause:
        case Cause.CURVE:
            sensor = scene.arm.joints[joint - 1].sensor
            share = ""
            peak, sd, from_line = candidate.deviation(found.b, found.covariance)
            if isinstance(sensor, Rvdt):
                of_scale = [OF_FULL_SCALE(x / sensor.full_scale_rad).with_unit for x in (peak, sd)]
                share = (
                    f" ({of_scale[0]} of full scale, sigma {of_scale[1]}, where "
                    f"{LINEARITY(sensor.linearity).with_unit} at most is stated)"
                )
            return Words(
                f"RVDT_{joint}",
                f"the RVDT of joint {joint} strays from its {'best line' if from_line else 'true angle'} "
                f"by up to {STRAY(peak).with_unit}{share}",
                f"have the RVDT of joint {joint} replaced or linearised, or calibrate with "
                f"--unsensed {joint}",
            )
        case Cause.TURN_ERROR:
            return Words(
                f"ENCODER_{joint}",
                f"the encoder of joint {joint} errs by {size} rms once or twice a turn, more "
                "than its file states",
                f"check the centring of joint {joint}'s encoder, or state its accuracy_deg",
            )
        case _:
            return Words(
                f"SAG_JOINT_{joint}",
                f"joint {joint} twists by {size} rms with the pose, more than its file states",
                f"look for play or a weak link at joint {joint}, or state its sag_deg",
            )


def _rms_along(joint: int, candidate: Candidate, found: Evidence, scene: FaultModels) -> float:
    """Size (rms, rad) of columns that act along one joint."""
    B = scene.system.B[:, :, joint - 1]
    moved = candidate.moves(found.b, len(B))
    return _rms((moved * B).sum(-1) / np.maximum((B**2).sum(-1), 1e-300))


def rms_displacement(
    candidate: Candidate, found: Evidence, scene: FaultModels
) -> tuple[float, float]:
    """Size of a displacement of the fixture: rad and m, largest over the poses it is about."""
    moved = candidate.moves(found.b, len(scene.system.w))
    whole = (scene.system.E @ moved[..., None])[..., 0]
    there = np.abs(moved).sum(-1) > 0.0
    turn = whole[there, :-3]
    return (
        float(np.sqrt((turn**2).sum(-1).mean())) if turn.size else 0.0,
        float(np.sqrt((whole[there, -3:] ** 2).sum(-1).mean())),
    )


def _displacement(size: tuple[float, float]) -> str:
    turn, shift = size
    known = [(SHIFTED, shift), (TURNED, turn)]
    # What rounds to nothing is not said beside what does not.
    words = [kind(x).with_unit for kind, x in known if kind(x) == kind.not_zero(x) and x > 0.0]
    return " and ".join(words) or SHIFTED.not_zero(shift).with_unit


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.asarray(values) ** 2)))

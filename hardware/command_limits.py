"""Limits of commands. This program checks changed commands before sending; virtual drives check commands on receipt.

Positions in counts are in sensor coordinates.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hardware.arm import DriveState, JointMode, JointState
from hardware.arm_description import JointDescription, JointScale
from hardware.canopen.cia402 import CLOSED_LOOP_STATES, Command, command_of, conditions, state_of
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.canopen.objects import CONTROL_PERIOD_S
from hardware.errors import CommandRefused, DriveNotReady, StopLatched


@dataclass(frozen=True, slots=True, kw_only=True)
class JointLimits:
    """Limits of one joint's commands."""

    joint: int
    lower_counts: int
    upper_counts: int
    """`lower_counts`, `upper_counts`: range, both ends allowed (607Dh)."""
    max_speed_rad_per_s: float
    max_step_counts: int
    """Largest change of the target in one control period."""

    def __post_init__(self) -> None:
        if self.lower_counts > self.upper_counts:
            raise ValueError(f"joint {self.joint}: the range ends before it begins")
        if not (math.isfinite(self.max_speed_rad_per_s) and self.max_speed_rad_per_s > 0.0):
            raise ValueError(f"joint {self.joint}: the largest speed must be positive")
        if self.max_step_counts < 1:
            raise ValueError(f"joint {self.joint}: the largest step must be at least one count")


def arm_limits(
    joints: Sequence[JointDescription], scales: Sequence[JointScale]
) -> tuple[JointLimits, ...]:
    """Return the command limits of every joint, converted to counts by the joint's scale."""
    return tuple(
        joint_limits(number, scale, (joint.lower_rad, joint.upper_rad), joint.max_speed_rad_per_s)
        for number, (joint, scale) in enumerate(zip(joints, scales, strict=True), 1)
    )


def joint_limits(
    joint: int, scale: JointScale, range_rad: tuple[float, float], max_speed_rad_per_s: float
) -> JointLimits:
    """Convert the range (lower, upper) and the speed limit of a joint to counts; the range is rounded inwards.

    The largest step includes one count for rounding, so that a move at exactly the largest speed passes.
    """
    step = max_speed_rad_per_s * CONTROL_PERIOD_S * scale.density
    lower, upper = sorted(map(scale.counts_of, range_rad))
    return JointLimits(
        joint=joint,
        # 1e-6 of a count: tolerance for the rounding error of a bound at a whole count.
        lower_counts=math.ceil(lower - 1e-6),
        upper_counts=math.floor(upper + 1e-6),
        max_speed_rad_per_s=max_speed_rad_per_s,
        max_step_counts=math.floor(step + 1e-6) + 1,
    )


def refuse_command(
    joint: int, *, in_control: bool, drive: DriveState, mode: JointMode | None
) -> str:
    """Return why a joint may not get a target in this drive state and `mode` (6061h); empty if it may."""
    if not in_control:
        return f"joint {joint}: the program that sent this target does not control the arm"
    if drive is not DriveState.OPERATION_ENABLED:
        return (
            f"joint {joint} accepts no target: its drive is in state '{drive.value}', not "
            f"'{DriveState.OPERATION_ENABLED.value}'"
        )
    if mode is not JointMode.POSITION:
        known = "no known" if mode is None else mode.value
        return f"joint {joint}: the drive is in {known} mode"
    return ""


def refuse_target(limits: JointLimits, target_counts: float, previous_counts: float) -> str:
    """Return why a target, sent one control period after the previous target, is refused; empty if it is allowed.

    A joint that is outside its range may only move towards the range.
    """
    if not (math.isfinite(target_counts) and math.isfinite(previous_counts)):
        return f"joint {limits.joint}: the target is not a finite number"
    step = abs(target_counts - previous_counts)
    if step > limits.max_step_counts:
        return f"joint {limits.joint}: the step of {step:.0f} counts exceeds {limits.max_step_counts} counts"
    outside = _distance_outside(limits, target_counts)
    if outside > 0.0 and not outside < _distance_outside(limits, previous_counts):
        return _out_of_range(limits, target_counts)
    return ""


def refuse_move(limits: JointLimits, target_counts: float, speed_rad_per_s: float) -> str:
    """Return why a move to this target at this speed is refused; empty if it is allowed."""
    if not math.isfinite(target_counts):
        return f"joint {limits.joint}: the target is not a finite number"
    if not math.isfinite(speed_rad_per_s):
        return f"joint {limits.joint}: the speed is not a finite number"
    if not 0.0 < speed_rad_per_s <= limits.max_speed_rad_per_s:
        return (
            f"joint {limits.joint}: a speed of {speed_rad_per_s:.4f} rad/s is not valid: it must be above 0 and at "
            f"most {limits.max_speed_rad_per_s:.4f} rad/s"
        )
    if _distance_outside(limits, target_counts) > 0.0:
        return _out_of_range(limits, target_counts)
    return ""


def _distance_outside(limits: JointLimits, counts: float) -> float:
    return max(limits.lower_counts - counts, counts - limits.upper_counts, 0.0)


def _out_of_range(limits: JointLimits, counts: float) -> str:
    ends = f"{limits.lower_counts} .. {limits.upper_counts}"
    return f"joint {limits.joint}: the target of {counts:.0f} counts is outside {ends}"


def admit(
    limits: Sequence[JointLimits],
    modes: Sequence[JointMode | None],
    *,
    in_control: bool,
    stopped: bool,
    sample: Sample,
    before: Setpoints | None,
    commands: Setpoints,
) -> None:
    """Check `commands` for one SYNC against the limits. `before`: the commands sent last, or None.

    The target of a joint that enters position mode, or whose drive has no power yet, must be within `max_step_counts`
    of the measured position. Any other change of a target is checked as a motion. Raises `CommandRefused` if a command
    is outside the limits, and `StopLatched` if STOP was pressed since the commands were made.
    """
    if before is commands:
        return
    for joint, (limit, mode, command) in enumerate(zip(limits, modes, commands, strict=True)):
        last = None if before is None else before[joint]
        if command.mode is not JointMode.POSITION or command == last:
            continue
        if command_of(command.controlword) is not Command.ENABLE_OPERATION:
            continue  # no other controlword causes motion
        target, measured = command.target_counts, sample.counts[joint]
        drive = state_of(sample.statuswords[joint])
        holds = last is not None and last.mode is JointMode.POSITION and drive in CLOSED_LOOP_STATES
        previous = last.target_counts if last is not None and holds else None
        entering = previous is None or mode is not JointMode.POSITION
        if previous is None and limit.joint in sample.missing:
            raise CommandRefused(
                f"joint {limit.joint} cannot hold its position: its drive did not answer the last SYNC"
            )
        if target == previous or (entering and abs(target - measured) <= limit.max_step_counts):
            continue
        if previous is None:
            refusal = refuse_target(limit, target, measured)
        elif stopped:
            raise StopLatched(f"joint {limit.joint}: STOP is latched")
        else:
            refusal = refuse_command(
                limit.joint, in_control=in_control, drive=drive, mode=mode
            ) or refuse_target(limit, target, previous)
        if refusal:
            raise CommandRefused(refusal)


def admit_move(
    limits: Sequence[JointLimits],
    scales: Sequence[JointScale],
    joints: Sequence[JointState],
    targets_rad: Mapping[int, float],
    speed_rad_per_s: float,
    *,
    in_control: bool,
) -> None:
    """Check a whole move: `CommandRefused` if a limit forbids it, `ValueError` for an unknown joint."""
    for joint, target_rad in targets_rad.items():
        if not 1 <= joint <= len(limits):
            raise ValueError(f"there is no joint {joint}")
        limit, state = limits[joint - 1], joints[joint - 1]
        target = scales[joint - 1].counts_of(target_rad)
        if refusal := refuse_command(
            joint, in_control=in_control, drive=state.drive, mode=state.mode
        ) or refuse_move(limit, target, speed_rad_per_s):
            raise CommandRefused(refusal)


def not_enabled(sample: Sample) -> DriveNotReady | None:
    """Return the error for the first drive that is not in *operation enabled*; None if all are."""
    for joint, status in enumerate(sample.statuswords, 1):
        if (state := state_of(status)) is not DriveState.OPERATION_ENABLED:
            return DriveNotReady(joint, state.value, conditions=conditions(status))
    return None

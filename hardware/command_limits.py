"""Limits of commands as pure functions, used before sending and by every virtual drive on receipt.

All positions are counts in sensor coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from hardware.arm import DriveState, JointMode
from hardware.arm_description import JointScale


class Reason(Enum):
    """Reason of a refusal."""

    NOT_FINITE = "not a finite number"
    STOPPED = "STOP is latched"
    NOT_IN_CONTROL = "the control token is not held"
    NOT_ENABLED = "the drive is not enabled"
    NOT_IN_POSITION_MODE = "the joint is not in position mode"
    OUT_OF_RANGE = "out of range"
    TOO_FAST = "too fast"
    STEP_TOO_LARGE = "step too large"


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A refused command."""

    joint: int
    reason: Reason
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class JointLimits:
    """Limits of one joint's commands.

    Attributes
    ----------
    lower_counts, upper_counts
        Range, both ends allowed (607Dh).
    max_step_counts
        Largest change of the target in one control period.
    """

    joint: int
    lower_counts: int
    upper_counts: int
    max_speed_rad_per_s: float
    max_step_counts: int

    def __post_init__(self) -> None:
        if self.lower_counts > self.upper_counts:
            raise ValueError(f"joint {self.joint}: the range ends before it begins")
        if not (math.isfinite(self.max_speed_rad_per_s) and self.max_speed_rad_per_s > 0.0):
            raise ValueError(f"joint {self.joint}: the largest speed must be positive")
        if self.max_step_counts < 1:
            raise ValueError(f"joint {self.joint}: the largest step must be at least one count")


def joint_limits(
    joint: int,
    scale: JointScale,
    *,
    lower_rad: float,
    upper_rad: float,
    max_speed_rad_per_s: float,
    period_s: float,
) -> JointLimits:
    """Limits of a joint given in radians; the range is rounded inwards.

    The largest step includes one count for rounding, so that a move at exactly the largest speed passes.
    """
    step = max_speed_rad_per_s * period_s * scale.density
    lower, upper = sorted((scale.counts_of(lower_rad), scale.counts_of(upper_rad)))
    return JointLimits(
        joint=joint,
        # 1e-6 of a count: tolerance for the rounding error of a bound at a whole count.
        lower_counts=math.ceil(lower - 1e-6),
        upper_counts=math.floor(upper + 1e-6),
        max_speed_rad_per_s=max_speed_rad_per_s,
        max_step_counts=math.floor(step + 1e-6) + 1,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """State of a joint when a command is checked; `mode` is the drive's actual mode (6061h)."""

    stopped: bool
    in_control: bool
    drive: DriveState
    mode: JointMode | None


def refuse_command(limits: JointLimits, situation: Situation) -> Refusal | None:
    """Reason to refuse every target for this joint in this situation; None if targets are allowed."""
    joint = limits.joint
    if situation.stopped:
        return _refusal(joint, Reason.STOPPED, "STOP is latched")
    if not situation.in_control:
        return _refusal(
            joint, Reason.NOT_IN_CONTROL, "the program that sent this does not control the arm"
        )
    if situation.drive is not DriveState.OPERATION_ENABLED:
        return _refusal(joint, Reason.NOT_ENABLED, f"the drive is in state {situation.drive.value}")
    if situation.mode is not JointMode.POSITION:
        mode = "no known" if situation.mode is None else situation.mode.value
        return _refusal(joint, Reason.NOT_IN_POSITION_MODE, f"the drive is in {mode} mode")
    return None


def refuse_target(
    limits: JointLimits, target_counts: float, previous_counts: float
) -> Refusal | None:
    """Reason to refuse a target one control period after the previous one; None if it is allowed.

    Outside its range a joint may only move towards it.
    """
    joint = limits.joint
    if not (math.isfinite(target_counts) and math.isfinite(previous_counts)):
        return _refusal(joint, Reason.NOT_FINITE, "the target is not a finite number")
    step = abs(target_counts - previous_counts)
    if step > limits.max_step_counts:
        return _refusal(
            joint,
            Reason.STEP_TOO_LARGE,
            f"a step of {step:.0f} counts is more than {limits.max_step_counts}",
        )
    outside = _outside(limits, target_counts)
    if outside > 0.0 and not outside < _outside(limits, previous_counts):
        return _out_of_range(limits, target_counts)
    return None


def refuse_move(
    limits: JointLimits, target_counts: float, speed_rad_per_s: float
) -> Refusal | None:
    """Reason to refuse a whole move to a target at a speed; None if it is allowed. The target must be in range."""
    joint = limits.joint
    if not math.isfinite(target_counts):
        return _refusal(joint, Reason.NOT_FINITE, "the target is not a finite number")
    if not math.isfinite(speed_rad_per_s):
        return _refusal(joint, Reason.NOT_FINITE, "the speed is not a finite number")
    if not 0.0 < speed_rad_per_s <= limits.max_speed_rad_per_s:
        return _refusal(
            joint,
            Reason.TOO_FAST,
            f"a speed of {speed_rad_per_s:.4f} rad/s is not valid: it must be above 0 and at most "
            f"{limits.max_speed_rad_per_s:.4f} rad/s",
        )
    if _outside(limits, target_counts) > 0.0:
        return _out_of_range(limits, target_counts)
    return None


def _outside(limits: JointLimits, counts: float) -> float:
    """Distance of a position from the range; 0 inside."""
    return max(limits.lower_counts - counts, counts - limits.upper_counts, 0.0)


def _out_of_range(limits: JointLimits, counts: float) -> Refusal:
    return _refusal(
        limits.joint,
        Reason.OUT_OF_RANGE,
        f"{counts:.0f} counts are outside {limits.lower_counts} .. {limits.upper_counts}",
    )


def _refusal(joint: int, reason: Reason, text: str) -> Refusal:
    return Refusal(joint=joint, reason=reason, text=f"joint {joint}: {text}")

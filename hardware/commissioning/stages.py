"""Stages, results and limits of the bench check."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from hardware.arm import ArmInterface, DriveState

Ask = Callable[[str], bool]
"""Asks the person beside the arm a question; returns whether the answer is yes."""


class Stage(Enum):
    """Stages of the bench check, in order; each stage requires that all earlier stages have passed."""

    LOOK = "look"
    """No drive is enabled."""
    HOLD = "hold"
    """Drives on, no motion; refusals; STOP."""
    MOVE = "move"
    """One joint at a time, there and back: halted, interrupted and stopped on the way."""
    FREE = "free"
    """One joint at a time in free mode."""
    LEAVE = "leave"
    """The arm is released as at the end of a session, and connected again."""
    SILENCE = "silence"
    """Loss of the operator's heartbeat, as when this program is killed."""


@dataclass(frozen=True, slots=True)
class Clause:
    """Result of the check of one requirement; `passed` is None if the requirement could not be tested."""

    name: str
    passed: bool | None
    text: str
    joint: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckFinding(Clause):
    """A clause, with the stage in which it was checked."""

    stage: Stage


SCATTER_RAD: Final = math.radians(0.5)
"""Limit of the standard deviation of single samples, mostly RVDT noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Samples per reading; limits of a joint's change at rest (`still_rad`) and deviation from target (`near_rad`)."""

    samples: int
    still_rad: float
    near_rad: float

    @property
    def single_sample_rad(self) -> float:
        """Limit of the error of a single sample at rest."""
        return max(self.still_rad, self.near_rad, SCATTER_RAD)


BENCH: Final = Bounds(samples=100, still_rad=math.radians(0.1), near_rad=math.radians(0.5))
"""Limits for an arm without fixture."""


def nothing_wrong(name: str, wrong: str, otherwise: str) -> Clause:
    """Return the result of a check, with the text `wrong` if it failed; it passed if that text is empty."""
    return Clause(name, not wrong, wrong or otherwise)


def position_rad(arm: ArmInterface, joint: int) -> float:
    """Return the position of a joint, rad."""
    return arm.snapshot().joints[joint - 1].position_rad


def enabled_joints(arm: ArmInterface) -> list[int]:
    """Return the joints whose drives are enabled."""
    joints = arm.snapshot().joints
    return [joint.joint for joint in joints if joint.drive is DriveState.OPERATION_ENABLED]


def declined(joint: int | None = None) -> Clause:
    """Return the result of a check that the person beside the arm declined."""
    return Clause("agreed", None, "not tried: declined", joint)


def deg(angle_rad: float, *, sign: bool = False) -> str:
    """Format an angle in degrees."""
    return f"{math.degrees(angle_rad):{'+' if sign else ''}.3f} deg"


def joints_words(joints: list[int], text: str) -> str:
    """Return a sentence about joints, such as ``joint 1, 3 is enabled``; empty if there are none."""
    return f"joint {', '.join(map(str, joints))} {text}" if joints else ""

"""What was tried on a bench and how it came out, in words with units. Knows no arm and no screen."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final

Ask = Callable[[str], bool]
"""Puts a question to whoever stands beside the arm; whether it is answered with yes."""


class Stage(Enum):
    """What is tried, in this order; each stage needs the ones before it."""

    LOOK = "look"
    """Nothing is enabled."""
    HOLD = "hold"
    """Drives on, nothing moves; what must be refused; STOP."""
    MOVE = "move"
    """One joint at a time by a little and back: halted, interrupted and stopped on the way."""
    FREE = "free"
    """One joint at a time lets go."""
    LEAVE = "leave"
    """Closed as at the end of a session, and connected again."""
    SILENCE = "silence"
    """The operator's heartbeat ends, as when this program is killed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clause:
    """One thing that an arm has to do: `passed` is None where it could not be found out; `text` says why."""

    name: str
    passed: bool | None
    text: str
    joint: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckFinding:
    """A clause, and the stage in which it was tried."""

    stage: Stage
    name: str
    passed: bool | None
    text: str
    joint: int | None = None

    @classmethod
    def of(cls, stage: Stage, clause: Clause) -> CheckFinding:
        """Say in which stage it was."""
        return cls(
            stage=stage,
            name=clause.name,
            passed=clause.passed,
            text=clause.text,
            joint=clause.joint,
        )


SCATTER_RAD: Final = math.radians(0.5)
"""Of single samples; an RVDT's noise is much of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """How near is near enough.

    Attributes
    ----------
    samples
        Of each reading.
    still_rad
        What a joint at rest may seem to turn between two readings.
    near_rad
        What a joint may miss of its target.
    """

    samples: int
    still_rad: float
    near_rad: float

    @property
    def once_rad(self) -> float:
        """What a single sample of a joint at rest may be off, noise and all."""
        return max(self.still_rad, self.near_rad, SCATTER_RAD)


BENCH: Final = Bounds(samples=100, still_rad=math.radians(0.1), near_rad=math.radians(0.5))
"""Of an arm whose hand is free."""


def declined(joint: int | None = None) -> Clause:
    """What nobody wanted tried."""
    return Clause(name="agreed", passed=None, text="not tried: nobody agreed to it", joint=joint)


def deg(angle_rad: float, *, sign: bool = False) -> str:
    """Write an angle with its unit."""
    return f"{math.degrees(angle_rad):{'+' if sign else ''}.3f} deg"


def joints_words(joints: list[int]) -> str:
    """Name joints: ``joint 1, 3``."""
    return f"joint {', '.join(map(str, joints))}"

"""Between virtual controller and plant: commands in, readings out. Knows neither side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from hardware.arm import JointMode


@dataclass(frozen=True, slots=True, kw_only=True)
class JointCommand:
    """What one drive does during a control period.

    Attributes
    ----------
    mode
        POSITION, FREE, or None: drive off, the joint held by its blocked valve.
    target_rad
        Position target in sensor coordinates; used in POSITION mode only.
    """

    mode: JointMode | None
    target_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantReading:
    """What the drives' sensors say at the end of a control period, one entry a joint.

    `position_counts` are relative to sensor coordinate zero.
    """

    position_counts: tuple[int, ...]
    torque_nm: tuple[float, ...]
    speed_rad_per_s: tuple[float, ...]


class PlantPort(Protocol):
    """A plant as the virtual controller sees it."""

    joint_count: int

    def step(self, commands: Sequence[JointCommand]) -> PlantReading:
        """Advance one control period with one command per joint."""
        ...


@runtime_checkable
class FixturePort(Protocol):
    """A plant whose hand is held by something that can fail."""

    def slip(self, slip_m: float) -> None:
        """Shift what holds the hand, along x of its frame."""
        ...

    def bind_hinge(self) -> None:
        """Let the hinge turn no more."""
        ...

"""Interface between virtual controller and plant: commands in, readings out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from hardware.arm import JointMode


@dataclass(frozen=True, slots=True, kw_only=True)
class JointCommand:
    """Command of one joint for a control period.

    `mode` None: drive off, the joint held by its blocked valve. `target_rad` in sensor coordinates, used in POSITION
    mode only.
    """

    mode: JointMode | None
    target_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantReading:
    """Readings at the end of a control period, one per joint; counts relative to sensor coordinate zero."""

    position_counts: tuple[int, ...]
    torque_nm: tuple[float, ...]
    speed_rad_per_s: tuple[float, ...]


class PlantPort(Protocol):
    """The plant as the virtual controller sees it."""

    joint_count: int

    def step(self, commands: Sequence[JointCommand]) -> PlantReading:
        """Advance one control period with one command per joint."""


@runtime_checkable
class FixturePort(Protocol):
    """A plant with a fixture that can fail."""

    def slip(self, slip_m: float) -> None:
        """Shift the fixture along x of its frame."""

    def bind_hinge(self) -> None:
        """Block the hinge."""

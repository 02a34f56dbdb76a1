"""Commissioning data of a virtual drive, and what it exchanges with the plant: commands in, readings out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol, runtime_checkable

from hardware.arm import JointMode
from hardware.arm_description import JointScale
from hardware.canopen.objects import CONTROL_PERIOD_S, SensorKind
from hardware.command_limits import JointLimits, joint_limits
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.sensors import Encoder, NoSensor, Rvdt


@dataclass(frozen=True, slots=True, kw_only=True)
class JointCommand:
    """Command of one joint for a control period.

    `mode` None: drive off, joint held by its blocked valve. `target_rad` is in sensor coordinates and used in POSITION
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
    """A plant whose fixture can fail."""

    def slip(self, slip_m: float) -> None:
        """Shift the fixture along x of its frame."""

    def bind_hinge(self) -> None:
        """Block the hinge."""


FOLLOWING_WINDOW_RAD = math.radians(3.0)
"""Wider than any servo deflection below the torque trip: only a failed sensor exceeds it."""
HOME_OFFSET_LIMIT_RAD = math.pi
_LARGEST_U32 = 2**32 - 1
_MILLIONTHS = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisSettings:
    """Settings of one drive.

    Attributes
    ----------
    joint
        1-based number; also the node.
    limits
        Command limits; the speed limit is the overspeed trip level as well.
    max_torque_nm, following_window_counts
        Trip levels of torque and following error (6065h).
    rated_torque_nm
        Reference of 6077h.
    sensor_kind, full_scale_microdeg, converter_bits
        2100h.
    increments, revolutions
        608Fh.
    lowest_counts, highest_counts
        Ends of the converter, at which the sensor counts as failed; None without ends.
    mode_switch_cycles
        Control periods from a new 6060h to the new 6061h.
    trip_cycles
        Control periods above a trip level until the drive trips.
    """

    joint: int
    scale: JointScale
    limits: JointLimits
    max_torque_nm: float
    rated_torque_nm: float
    following_window_counts: int
    sensor_kind: SensorKind
    full_scale_microdeg: int
    converter_bits: int
    increments: int
    revolutions: int
    lowest_counts: int | None = None
    highest_counts: int | None = None
    mode_switch_cycles: int = 3
    trip_cycles: int = 3

    @property
    def max_speed_counts_per_s(self) -> int:
        """607Fh."""
        return round(self.limits.max_speed_rad_per_s * self.scale.counts_per_rad)

    @property
    def home_offset_limit_counts(self) -> int:
        """Largest home offset of a revolute joint, in either direction."""
        return round(HOME_OFFSET_LIMIT_RAD * self.scale.counts_per_rad)


def joint_scale(joint: Joint) -> JointScale:
    """Scale of a joint's sensor; `ValueError` if it has none."""
    match joint.sensor:
        case Encoder() as encoder:
            return JointScale(counts_per_rad=encoder.counts_per_rev / (2.0 * math.pi))
        case Rvdt() as rvdt:
            return JointScale(counts_per_rad=1.0 / rvdt.resolution_rad)
        case NoSensor():
            raise ValueError(f"joint {joint.name!r} has no sensor for a drive to report")


def arm_axes(arm: ArmModel) -> tuple[AxisSettings, ...]:
    """Settings of all drives of an arm, joint 1 first; ValueError for a joint without a sensor."""
    return tuple(axis(number, joint) for number, joint in enumerate(arm.joints, start=1))


def axis(number: int, joint: Joint) -> AxisSettings:
    """Settings of one drive; ValueError for a joint without a sensor."""
    scale = joint_scale(joint)
    lowest: int | None = None
    highest: int | None = None
    if isinstance(joint.sensor, Rvdt):
        kind, bits = SensorKind.RVDT, joint.sensor.bits
        microdeg = round(math.degrees(joint.sensor.full_scale_rad) * _MILLIONTHS)
        per_turn = Fraction(360 * _MILLIONTHS * 2**bits, microdeg)
        # The converter's zero is the RVDT's, in the middle of the range.
        zero, half = round(joint.middle_rad / joint.sensor.resolution_rad), 2 ** (bits - 1)
        lowest, highest = zero - half, zero + half - 1
    else:
        kind, bits, microdeg = SensorKind.ENCODER, 0, 360 * _MILLIONTHS
        per_turn = Fraction(scale.to_counts(2.0 * math.pi))
    if per_turn.numerator > _LARGEST_U32:
        per_turn = per_turn.limit_denominator(10_000)
    return AxisSettings(
        joint=number,
        scale=scale,
        limits=joint_limits(
            number,
            scale,
            lower_rad=joint.lower_rad,
            upper_rad=joint.upper_rad,
            max_speed_rad_per_s=joint.max_speed_rad_per_s,
            period_s=CONTROL_PERIOD_S,
        ),
        max_torque_nm=joint.max_torque_nm,
        rated_torque_nm=joint.max_torque_nm,
        following_window_counts=max(1, scale.to_counts(FOLLOWING_WINDOW_RAD)),
        sensor_kind=kind,
        full_scale_microdeg=microdeg,
        converter_bits=bits,
        increments=per_turn.numerator,
        revolutions=per_turn.denominator,
        lowest_counts=lowest,
        highest_counts=highest,
    )

"""Commissioning data of a virtual drive, and what it exchanges with the plant: commands in, readings out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from hardware.arm import JointMode
from hardware.arm_description import JointScale
from hardware.canopen.objects import SensorKind
from hardware.command_limits import joint_limits
from hardware.virtual.sensor_counts import converter_ends
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.sensors import Encoder, NoSensor, Rvdt


@dataclass(frozen=True, slots=True, kw_only=True)
class JointCommand:
    """Command of one joint for a control period.

    If `mode` is None, the drive is off and a blocked valve holds the joint. `target_rad` is in sensor coordinates
    and is used in POSITION mode only.
    """

    mode: JointMode | None
    target_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantReading:
    """Readings at the end of a control period, one per joint; counts relative to sensor coordinate zero."""

    position_counts: tuple[int, ...]
    torque_nm: tuple[float, ...]
    speed_rad_per_s: tuple[float, ...]


FOLLOWING_WINDOW_RAD = math.radians(3.0)
"""Following error window: wider than any servo deflection below the torque trip; only a failed sensor exceeds it."""
HOME_OFFSET_LIMIT_RAD = math.pi
_LARGEST_U32 = 2**32 - 1
_MILLIONTHS = 1_000_000


class AxisSettings:
    """Settings of the drive of joint `number`; `ValueError` for a joint without a sensor.

    Attributes
    ----------
    joint
        1-based number; also the node.
    limits
        Command limits; the speed limit is the overspeed trip level as well.
    max_torque_nm, following_window_counts
        Trip levels of torque (also the rated torque) and of the following error (6065h).
    max_speed_counts_per_s; increments, revolutions
        Values of 607Fh and 608Fh.
    sensor_kind, full_scale_microdeg, converter_bits
        Values of 2100h.
    lowest_counts, highest_counts
        Ends of an RVDT's converter, at which the sensor counts as failed; infinite for an encoder.
    mode_switch_cycles, trip_cycles
        Control periods from a new 6060h to the new 6061h, and above a trip level until the drive trips.
    """

    mode_switch_cycles = trip_cycles = 3

    def __init__(self, number: int, joint: Joint) -> None:
        scale = self.scale = joint_scale(joint)
        self.joint, self.max_torque_nm = number, joint.max_torque_nm
        ends_rad = joint.lower_rad, joint.upper_rad
        self.limits = joint_limits(number, scale, ends_rad, joint.max_speed_rad_per_s)
        self.following_window_counts = max(1, scale.to_counts(FOLLOWING_WINDOW_RAD))
        self.max_speed_counts_per_s = round(joint.max_speed_rad_per_s * scale.counts_per_rad)
        self.home_offset_limit_counts = round(HOME_OFFSET_LIMIT_RAD * scale.counts_per_rad)
        self.sensor_kind, self.converter_bits = SensorKind.ENCODER, 0
        self.full_scale_microdeg = 360 * _MILLIONTHS
        self.lowest_counts, self.highest_counts = -math.inf, math.inf
        per_turn = Fraction(scale.to_counts(2.0 * math.pi))
        if isinstance(sensor := joint.sensor, Rvdt):
            self.sensor_kind, self.converter_bits = SensorKind.RVDT, sensor.bits
            full_scale_deg = math.degrees(sensor.full_scale_rad)
            self.full_scale_microdeg = round(full_scale_deg * _MILLIONTHS)
            self.lowest_counts, self.highest_counts = converter_ends(joint, sensor)
            codes = 360 * _MILLIONTHS * 2**sensor.bits
            per_turn = Fraction(codes, self.full_scale_microdeg)
        if per_turn.numerator > _LARGEST_U32:
            per_turn = per_turn.limit_denominator(10_000)
        self.increments, self.revolutions = per_turn.numerator, per_turn.denominator


def joint_scale(joint: Joint) -> JointScale:
    """Return the scale of a joint's sensor; `ValueError` if the joint has none."""
    match joint.sensor:
        case Encoder() as encoder:
            return JointScale(counts_per_rad=encoder.counts_per_rev / (2.0 * math.pi))
        case Rvdt() as rvdt:
            return JointScale(counts_per_rad=1.0 / rvdt.resolution_rad)
        case NoSensor():
            raise ValueError(f"joint {joint.name!r} has no sensor for a drive to report")


def arm_axes(arm: ArmModel) -> tuple[AxisSettings, ...]:
    """Return the settings of all drives of an arm, joint 1 first; `ValueError` for a joint without a sensor."""
    return tuple(AxisSettings(number, joint) for number, joint in enumerate(arm.joints, start=1))

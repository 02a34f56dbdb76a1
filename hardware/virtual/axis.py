"""A joint of the virtual arm: drive settings, sensor, and the data that drive and plant exchange.

A sensor converts the joint's true angle to counts, which are zero at the zero of sensor coordinates. The electrical
zero of an RVDT is at the middle of the joint's range; its converter saturates at the ends of full scale.
"""

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial import legendre

from hardware.arm import JointMode
from hardware.arm_description import JointScale
from hardware.canopen.objects import SensorKind, joint_node
from hardware.command_limits import joint_limits
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.sensors import Encoder, NoSensor, Rvdt

JointCommand = tuple[JointMode | None, float]
"""Command of a joint for a control period: mode, and target in sensor coordinates (rad, used in POSITION mode only).
If the mode is None, the drive is off and a blocked valve holds the joint."""


class PlantReading(NamedTuple):
    """Readings at the end of a control period, one per joint; counts relative to sensor coordinate zero."""

    position_counts: tuple[int, ...]
    torque_nm: tuple[float, ...]
    speed_rad_per_s: tuple[float, ...]


LEGENDRE_DEGREES = (2, 3, 4, 5)
"""Degrees of the Legendre polynomials of a linearity deviation, all orthogonal to straight lines."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearityDeviation:
    """Deviation of an RVDT from its best-fit line: a sum of Legendre polynomials of x = angle / half of full scale.

    `coefficients_rad` (4,) are the factors of the polynomials of degrees 2 to 5. Without degrees 0 and 1, the best-fit
    line of the deviation is zero, so the peak of the deviation is the linearity that a maker states.
    """

    coefficients_rad: tuple[float, ...]
    half_scale_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, full_scale_rad: float, peak: float) -> Self:
        """Draw a random polynomial of degree 5, whose terms 4 and 5 are weaker; `peak` is a fraction of full scale."""
        shape = rng.choice((-1.0, 1.0), 4) * rng.uniform(0.4, 1.0, 4) * (1.0, 1.0, 0.4, 0.2)
        unit = cls(coefficients_rad=tuple(shape.tolist()), half_scale_rad=0.5 * full_scale_rad)
        scale = peak * full_scale_rad / unit.peak_rad()
        return replace(unit, coefficients_rad=tuple((shape * scale).tolist()))

    def deviation_rad(self, from_zero_rad: float) -> float:
        """Return reading minus true angle, rad, at an angle from electrical zero (clipped to full scale)."""
        x = min(1.0, max(-1.0, from_zero_rad / self.half_scale_rad))
        square = x * x
        c2, c3, c4, c5 = self.coefficients_rad
        return (
            c2 * (1.5 * square - 0.5)
            + c3 * x * (2.5 * square - 1.5)
            + c4 * ((4.375 * square - 3.75) * square + 0.375)
            + c5 * x * ((7.875 * square - 8.75) * square + 1.875)
        )

    def peak_rad(self) -> float:
        """Return the largest absolute deviation over full scale, rad; it lies at an end or where the slope vanishes."""
        series = np.zeros(LEGENDRE_DEGREES[-1] + 1)
        series[list(LEGENDRE_DEGREES)] = self.coefficients_rad
        roots = legendre.legroots(legendre.legder(series)) if np.any(series) else np.zeros(0)
        turns = [r.real for r in roots if abs(r.imag) < 1e-9 and abs(r.real) < 1.0]
        return float(np.abs(legendre.legval(np.array([-1.0, *turns, 1.0]), series)).max())


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSensor:
    """One joint's sensor with its errors; `noise_counts` is the standard deviation before rounding.

    The sensor saturates at `lowest_counts` and `highest_counts`. `curve` and `zero_rad`: linearity deviation and
    electrical zero of an RVDT.
    """

    resolution_rad: float
    noise_counts: float
    lowest_counts: float = -math.inf
    highest_counts: float = math.inf
    curve: LinearityDeviation | None = None
    zero_rad: float = 0.0

    def deviation_rad(self, angle_rad: float) -> float:
        """Return the systematic error of the reading, rad, at a true angle in sensor coordinates."""
        return 0.0 if self.curve is None else self.curve.deviation_rad(angle_rad - self.zero_rad)

    def counts(self, angle_rad: float, standard_normal: float) -> int:
        """Return the counts at a true angle (sensor coordinates); the noise is `standard_normal` * `noise_counts`."""
        reading = (angle_rad + self.deviation_rad(angle_rad)) / self.resolution_rad
        count = round(reading + self.noise_counts * standard_normal)
        return int(min(max(count, self.lowest_counts), self.highest_counts))


def joint_sensor(
    joint: Joint, *, with_noise: bool, curve: LinearityDeviation | None
) -> JointSensor:
    """Return a simulated sensor; `curve`: linearity deviation of an RVDT. `ValueError` if the joint has no sensor.

    The zero of an RVDT's converter is at the middle of the joint's range.
    """
    match joint.sensor:
        case Encoder() as encoder:
            return JointSensor(
                resolution_rad=encoder.resolution_rad,
                noise_counts=encoder.noise_counts if with_noise else 0.0,
            )
        case Rvdt() as rvdt:
            zero, half = round(joint.middle_rad / rvdt.resolution_rad), 2 ** (rvdt.bits - 1)
            return JointSensor(
                resolution_rad=rvdt.resolution_rad,
                noise_counts=rvdt.noise_lsb if with_noise else 0.0,
                lowest_counts=zero - half,
                highest_counts=zero + half - 1,
                curve=curve,
                zero_rad=zero * rvdt.resolution_rad,
            )
        case NoSensor():
            raise ValueError(f"joint {joint.name!r} has no sensor for a drive to report")


FOLLOWING_WINDOW_RAD = math.radians(3.0)
"""Following error window. It is wider than any servo deflection at torques below the trip level, so that only a fault
exceeds it."""
HOME_OFFSET_LIMIT_RAD = math.pi
_LARGEST_U32 = 2**32 - 1
_MILLIONTHS = 1_000_000


class AxisSettings:
    """Settings of the drive of joint `number`; `ValueError` for a joint without a sensor or without a node."""

    mode_switch_cycles = trip_cycles = 3
    """Control periods from a mode request to the new mode, and from excess torque or following error to the trip."""

    def __init__(self, number: int, joint: Joint) -> None:
        self.joint = joint_node(number)
        """1-based number; also the node number."""
        sensor = joint_sensor(joint, with_noise=False, curve=None)
        self.lowest_counts, self.highest_counts = sensor.lowest_counts, sensor.highest_counts
        """Ends of an RVDT's converter, at which the sensor counts as failed; infinite for an encoder."""
        match joint.sensor:
            case Encoder(counts_per_rev=counts_per_rev):
                per_rad, per_turn = counts_per_rev / math.tau, Fraction(counts_per_rev)
                self.sensor_kind, self.converter_bits = SensorKind.ENCODER, 0
                self.full_scale_microdeg = 360 * _MILLIONTHS
            case Rvdt() as rvdt:
                per_rad = 1.0 / rvdt.resolution_rad
                self.sensor_kind, self.converter_bits = SensorKind.RVDT, rvdt.bits
                self.full_scale_microdeg = round(math.degrees(rvdt.full_scale_rad) * _MILLIONTHS)
                per_turn = Fraction(360 * _MILLIONTHS * 2**rvdt.bits, self.full_scale_microdeg)
        """`sensor_kind`, `converter_bits`, `full_scale_microdeg`: 2100h."""
        self.scale = scale = JointScale(counts_per_rad=per_rad)
        ends_rad = joint.lower_rad, joint.upper_rad
        self.limits = joint_limits(number, scale, ends_rad, joint.max_speed_rad_per_s)
        """Command limits; the speed limit is the overspeed trip level as well."""
        self.max_torque_nm = joint.max_torque_nm
        """Trip level of torque; also the rated torque."""
        self.following_window_counts = max(1, scale.to_counts(FOLLOWING_WINDOW_RAD))
        """Trip level of the following error (6065h)."""
        self.max_speed_counts_per_s = round(joint.max_speed_rad_per_s * scale.counts_per_rad)
        """Speed limit (607Fh)."""
        self.home_offset_limit_counts = round(HOME_OFFSET_LIMIT_RAD * scale.counts_per_rad)
        """Largest magnitude of the home offset (607Ch)."""
        if per_turn.numerator > _LARGEST_U32:
            per_turn = per_turn.limit_denominator(10_000)
        self.increments, self.revolutions = per_turn.numerator, per_turn.denominator
        """Encoder resolution: subs 1 and 2 of 608Fh."""


def arm_axes(arm: ArmModel) -> tuple[AxisSettings, ...]:
    """Return the settings of all drives of an arm, joint 1 first; raises `ValueError` as `AxisSettings` does."""
    return tuple(AxisSettings(number, joint) for number, joint in enumerate(arm.joints, start=1))

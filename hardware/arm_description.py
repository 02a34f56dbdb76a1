"""The arm the operator expects on the bus, in drive terms. Knows no chain, no solver and no file."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hardware.scale import JointScale


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderDescription:
    """Incremental encoder with `counts_per_rev` counts a turn."""

    counts_per_rev: int

    @property
    def counts_per_rad(self) -> float:
        """Counts in one radian."""
        return self.counts_per_rev / (2.0 * math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class RvdtDescription:
    """RVDT read by a converter of `bits` over `full_scale_rad`."""

    bits: int
    full_scale_rad: float

    @property
    def counts_per_rad(self) -> float:
        """Counts in one radian."""
        return float(2**self.bits / self.full_scale_rad)

    @property
    def full_scale_microdegrees(self) -> int:
        """Full scale as 2100h sub 2 holds it."""
        return round(math.degrees(self.full_scale_rad) * 1e6)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointDescription:
    """One joint as its drive should describe itself.

    Attributes
    ----------
    name
        What the operator calls it.
    lower_rad, upper_rad
        Range in sensor coordinates.
    max_speed_rad_per_s, max_torque_nm
        Limits for commands and for tripping.
    sensor
        What 608Fh and 2100h of its drive should say.
    """

    name: str
    lower_rad: float
    upper_rad: float
    max_speed_rad_per_s: float
    max_torque_nm: float
    sensor: EncoderDescription | RvdtDescription

    @property
    def scale(self) -> JointScale:
        """Drive counts against radians."""
        return JointScale(counts_per_rad=self.sensor.counts_per_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmDescription:
    """The arm as a whole; `model` as in 2020h sub 1 of the supervisor, joints in order 1..n."""

    model: str
    joints: tuple[JointDescription, ...]

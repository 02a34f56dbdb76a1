"""Description of the arm that is expected on the bus: joints, limits, sensors, and the scale of their counts."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class JointScale:
    """Linear relation of one joint's counts to its sensor coordinate (rad)."""

    counts_per_rad: float
    """Encoder: counts per turn / 2 pi; RVDT: 1 / (one count in rad). Negative if the drive counts backwards."""
    zero_counts: int = 0
    """Count at sensor coordinate 0."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.counts_per_rad) or self.counts_per_rad == 0.0:
            raise ValueError("a scale needs a finite number of counts per radian that is not zero")

    @property
    def density(self) -> float:
        """Counts per radian, without the sign of the counting direction."""
        return abs(self.counts_per_rad)

    def counts_of(self, angle_rad: float) -> float:
        """Return the count that corresponds to an angle, not rounded."""
        return angle_rad * self.counts_per_rad + self.zero_counts

    def to_counts(self, angle_rad: float) -> int:
        """Return the count nearest to an angle; `ValueError` or `OverflowError` if the angle is not finite."""
        return round(self.counts_of(angle_rad))

    def to_rad(self, counts: float) -> float:
        """Return the angle (rad) that corresponds to a count, or to a mean of counts."""
        return (counts - self.zero_counts) / self.counts_per_rad


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderDescription:
    """Incremental encoder with `counts_per_rev` counts per turn."""

    counts_per_rev: int

    @property
    def counts_per_rad(self) -> float:
        """Counts in one radian."""
        return self.counts_per_rev / (2.0 * math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class RvdtDescription:
    """RVDT with a converter of `bits` bits over `full_scale_rad`."""

    bits: int
    full_scale_rad: float

    @property
    def counts_per_rad(self) -> float:
        """Counts in one radian."""
        return float(2**self.bits / self.full_scale_rad)

    @property
    def full_scale_microdegrees(self) -> int:
        """Full scale in millionths of a degree, as in 2100h sub 2."""
        return round(math.degrees(self.full_scale_rad) * 1e6)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointDescription:
    """One joint of the arm file.

    Attributes
    ----------
    lower_rad, upper_rad
        Range in sensor coordinates.
    max_speed_rad_per_s, max_torque_nm
        Largest allowed speed and torque; a drive that exceeds either trips.
    sensor
        Sensor that 608Fh and 2100h should report.
    """

    name: str
    lower_rad: float
    upper_rad: float
    max_speed_rad_per_s: float
    max_torque_nm: float
    sensor: EncoderDescription | RvdtDescription

    @property
    def scale(self) -> JointScale:
        """Scale of the joint's sensor, with count 0 at sensor coordinate 0."""
        return JointScale(counts_per_rad=self.sensor.counts_per_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmDescription:
    """Model and joints 1..n of the arm; a supervisor must report this model in 2020h sub 1."""

    model: str
    joints: tuple[JointDescription, ...]

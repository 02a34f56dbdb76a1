"""Conversion between a joint's counts and radians in sensor coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class JointScale:
    """Scale of one joint.

    Attributes
    ----------
    counts_per_rad
        Encoder: counts per revolution / 2 pi; RVDT: 1 / one bit in rad. Negative if the drive counts backwards.
    zero_counts
        Count at sensor coordinate 0.
    """

    counts_per_rad: float
    zero_counts: int = 0

    def __post_init__(self) -> None:
        if not math.isfinite(self.counts_per_rad) or self.counts_per_rad == 0.0:
            raise ValueError("a scale needs a finite number of counts per radian that is not zero")

    @property
    def density(self) -> float:
        """Counts per radian, positive."""
        return abs(self.counts_per_rad)

    def counts_of(self, angle_rad: float) -> float:
        """Count of an angle, with fraction."""
        return angle_rad * self.counts_per_rad + self.zero_counts

    def to_counts(self, angle_rad: float) -> int:
        """Nearest count; ValueError or OverflowError if not finite."""
        return round(self.counts_of(angle_rad))

    def to_rad(self, counts: float) -> float:
        """Angle of a count, or of a mean of counts."""
        return (counts - self.zero_counts) / self.counts_per_rad

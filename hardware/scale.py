"""Counts of a joint's sensor against radians in sensor coordinates. Knows no sensor kind and no bus."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class JointScale:
    """One joint's scale; count 0 is sensor coordinate 0.

    Attributes
    ----------
    counts_per_rad
        Encoder: counts per revolution / 2 pi. RVDT: 1 / one bit in rad.
    """

    counts_per_rad: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.counts_per_rad) and self.counts_per_rad > 0.0):
            raise ValueError("a scale needs a positive number of counts per radian")

    def to_counts(self, angle_rad: float) -> int:
        """Nearest count; ValueError or OverflowError for what is not finite."""
        return round(angle_rad * self.counts_per_rad)

    def to_rad(self, counts: float) -> float:
        """Angle of a count, or of a mean of counts."""
        return counts / self.counts_per_rad

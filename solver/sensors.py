"""What each joint's angle sensor can tell: resolution and noise. Knows no bus, no plant and no truth."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoder:
    """Incremental encoder: `counts_per_rev` counts, noise in counts (rms)."""

    counts_per_rev: int
    noise_counts: float = 0.0

    @property
    def resolution_rad(self) -> float:
        """One count."""
        return 2.0 * math.pi / self.counts_per_rev

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of one reading: count^2/12 and the stated noise."""
        return self.resolution_rad * math.sqrt(1.0 / 12.0 + self.noise_counts**2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rvdt:
    """Rotary variable differential transformer read by an ADC of `bits` over `full_scale_rad`.

    `linearity` is the largest deviation from the best-fit straight line, as a fraction of full
    scale; it is a systematic curve and not part of `sigma_rad`.
    """

    bits: int
    full_scale_rad: float
    linearity: float
    noise_lsb: float

    @property
    def resolution_rad(self) -> float:
        """One least significant bit."""
        return float(self.full_scale_rad / 2**self.bits)

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of one reading: LSB^2/12 and the stated noise, without the curve."""
        return self.resolution_rad * math.sqrt(1.0 / 12.0 + self.noise_lsb**2)

    @property
    def linearity_rad(self) -> float:
        """Largest deviation from the best-fit line that the specification allows."""
        return self.linearity * self.full_scale_rad


@dataclass(frozen=True, slots=True)
class NoSensor:
    """A joint that is not sensed."""


Sensor = Encoder | Rvdt | NoSensor

"""What each joint's angle sensor can tell: resolution and noise. Knows no bus, no plant and no truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

DITHER = 0.5
"""Noise (rms, in counts) from which rounding errors of repeated readings average out too."""


def _variance_of_mean(resolution_rad: float, noise_counts: float, samples: int) -> float:
    """Without dither every reading of a still joint is rounded alike, and stays so on average."""
    rounding = 1.0 / 12.0 / (samples if noise_counts >= DITHER else 1)
    return resolution_rad**2 * (rounding + noise_counts**2 / samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoder:
    """Incremental encoder: `counts_per_rev` counts, noise in counts (rms).

    `accuracy_rad` is how far its scale is off once and twice per turn (an eccentric or oval disc):
    one standard deviation of each; systematic, so not part of `sigma_rad`.
    """

    counts_per_rev: int
    noise_counts: float = 0.0
    accuracy_rad: float = 0.0

    @property
    def resolution_rad(self) -> float:
        """One count."""
        return 2.0 * math.pi / self.counts_per_rev

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of one reading: count^2/12 and the stated noise."""
        return self.resolution_rad * math.sqrt(1.0 / 12.0 + self.noise_counts**2)

    def variance_of_mean_rad2(self, samples: int) -> float:
        """Variance of the mean of `samples` readings of a joint that stands still."""
        return _variance_of_mean(self.resolution_rad, self.noise_counts, samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rvdt:
    """Rotary variable differential transformer read by an ADC of `bits` over `full_scale_rad`.

    `linearity` is the largest deviation from the best-fit straight line, as a fraction of full
    scale; `gain` is how far the slope of that line is off 1, one standard deviation. Data sheets
    state the two apart. Both are systematic and not part of `sigma_rad`.
    """

    bits: int
    full_scale_rad: float
    linearity: float
    noise_lsb: float
    gain: float = 0.0

    @property
    def resolution_rad(self) -> float:
        """One least significant bit."""
        return float(self.full_scale_rad / 2**self.bits)

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of one reading: LSB^2/12 and the stated noise, without the curve."""
        return self.resolution_rad * math.sqrt(1.0 / 12.0 + self.noise_lsb**2)

    def variance_of_mean_rad2(self, samples: int) -> float:
        """Variance of the mean of `samples` readings of a joint that stands still."""
        return _variance_of_mean(self.resolution_rad, self.noise_lsb, samples)

    @property
    def linearity_rad(self) -> float:
        """Largest deviation from the best-fit line that the specification allows."""
        return self.linearity * self.full_scale_rad

    @property
    def gain_rad(self) -> float:
        """What an error of the gain brings, rms over full scale: one standard deviation."""
        return self.gain * self.full_scale_rad / math.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class NoSensor:
    """A joint that is not sensed."""


Sensor = Encoder | Rvdt | NoSensor

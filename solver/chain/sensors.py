"""Angle sensors of the joints: resolution, noise and systematic errors."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from solver.arrays import FloatArray

DITHER = 0.5
"""Smallest noise (rms, in counts) with which the rounding errors of repeated readings average out."""


def _variance_of_mean(resolution_rad: float, noise_counts: float, samples: int) -> float:
    """Variance (rad^2) of the mean of `samples` readings; rounding averages out if the noise is at least `DITHER`."""
    rounding = 1.0 / 12.0 / (samples if noise_counts >= DITHER else 1)
    return resolution_rad**2 * (rounding + noise_counts**2 / samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoder:
    """Incremental encoder with `counts_per_rev` counts per turn and `noise_counts` counts of noise (rms).

    `accuracy_rad`: standard deviation of each of two periodic errors. Their periods are one turn (eccentric disc) and
    half a turn (oval disc). The errors are systematic and not part of `sigma_rad`.
    """

    linearity_rad: ClassVar[float] = 0.0
    gain_rad: ClassVar[float] = 0.0

    counts_per_rev: int
    noise_counts: float = 0.0
    accuracy_rad: float = 0.0

    @property
    def resolution_rad(self) -> float:
        """Angle of one count, rad."""
        return 2.0 * math.pi / self.counts_per_rev

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of one reading: rounding (variance count^2/12) and noise."""
        return self.resolution_rad * math.sqrt(1.0 / 12.0 + self.noise_counts**2)

    def variance_of_mean_rad2(self, samples: int) -> float:
        """Variance of the mean of `samples` readings of a joint at standstill."""
        return _variance_of_mean(self.resolution_rad, self.noise_counts, samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rvdt:
    """Rotary variable differential transformer read by an ADC of `bits` over `full_scale_rad`.

    `linearity`: largest deviation from the best-fit straight line, as a fraction of full scale. `gain`: standard
    deviation of the slope of this line from 1. The two are systematic errors and not part of `sigma_rad`.
    """

    accuracy_rad: ClassVar[float] = 0.0

    bits: int
    full_scale_rad: float
    linearity: float
    noise_lsb: float
    gain: float = 0.0

    @property
    def resolution_rad(self) -> float:
        """Angle of one least significant bit, rad."""
        return float(self.full_scale_rad / 2**self.bits)

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of one reading: rounding (variance LSB^2/12) and noise, without linearity deviation."""
        return self.resolution_rad * math.sqrt(1.0 / 12.0 + self.noise_lsb**2)

    def variance_of_mean_rad2(self, samples: int) -> float:
        """Variance of the mean of `samples` readings of a joint at standstill."""
        return _variance_of_mean(self.resolution_rad, self.noise_lsb, samples)

    @property
    def linearity_rad(self) -> float:
        """Largest deviation from the best-fit line that the specification allows."""
        return self.linearity * self.full_scale_rad

    @property
    def gain_rad(self) -> float:
        """Deviation caused by a gain error of one standard deviation: rms over the full scale, rad."""
        return self.gain * self.full_scale_rad / math.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class NoSensor:
    """No sensor: the joint's angle is not measured, and all errors of its reading are 0."""

    sigma_rad: ClassVar[float] = 0.0
    accuracy_rad: ClassVar[float] = 0.0
    linearity_rad: ClassVar[float] = 0.0
    gain_rad: ClassVar[float] = 0.0

    def variance_of_mean_rad2(self, samples: int) -> float:
        """Return 0: without a sensor there is no reading error."""
        return 0.0


Sensor = Encoder | Rvdt | NoSensor


WAVES = 4
"""Number of basis functions of an encoder's error, as returned by `encoder_waves`."""

SATURATION = 1.2
"""Largest angle from mid-scale at which a `SensorCurve` is evaluated, in units of half the full scale: beyond it a
sensor saturates, and polynomials would diverge."""

SHAPE_WEIGHTS = (1.0, 1.0, 0.5, 0.35, 0.25, 0.18, 0.14, 0.11, 0.09)
"""Relative prior standard deviations of the coefficients of P2..P10 (Legendre): an RVDT's linearity deviation is mostly
a bow (P2) and an S (P3), and higher terms fall with the square of the degree."""

LOWEST = 2
"""Lowest degree of the Legendre polynomials used. From degree 2 on, they are orthogonal to every line, as a linearity
deviation is."""


def _power_series() -> FloatArray:
    """Return P2..P10 times `SHAPE_WEIGHTS` (9 columns) as coefficients of the powers 1, x, ..., x^10 (11 rows)."""
    powers = np.zeros((len(SHAPE_WEIGHTS) + LOWEST, len(SHAPE_WEIGHTS)))
    for k, weight in enumerate(SHAPE_WEIGHTS):
        series = np.polynomial.legendre.leg2poly(np.eye(k + LOWEST + 1)[k + LOWEST])
        powers[: len(series), k] = weight * series
    return powers


_POWERS = _power_series()
"""Power series of the weighted P2..P10: a matrix product evaluates all of them, and rounding costs 3 of 16 digits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorCurve:
    """Deviation of one sensor from the true angle: a line plus ``sum_k c_k P_k(x)``, k = 2, 3, ...

    The line is the gain error, the Legendre polynomials P_k are the linearity deviation; either may be left out. x is
    the angle from `middle_rad`, divided by `half_scale_rad`. There is no P_0, as a constant is part of the offset.

    `joint`: 1-based. `middle_rad`, `half_scale_rad`: electrical zero (sensor coordinates), and half of the full scale.
    `gain`: standard deviation of the gain error; if it is 0, there is no line. `bent`: whether there are polynomials.
    """

    joint: int
    middle_rad: float
    half_scale_rad: float
    gain: float = 0.0
    bent: bool = True

    @property
    def lines(self) -> int:
        """Number of basis functions for the gain error: 1, or 0 if the gain is exact."""
        return int(self.gain > 0.0)

    @property
    def bends(self) -> int:
        """Number of Legendre polynomials in the basis; 0 unless `bent`."""
        return len(SHAPE_WEIGHTS) if self.bent else 0

    @property
    def width(self) -> int:
        """Number of basis functions (line and polynomials); 0 for a sensor without systematic errors."""
        return self.lines + self.bends

    def basis(self, theta_rad: FloatArray) -> FloatArray:
        """Basis functions (m, width) at sensor angles (m,): a line of slope `gain`, then the weighted polynomials."""
        x = (theta_rad - self.middle_rad) / self.half_scale_rad
        x = np.clip(x, -SATURATION, SATURATION)
        shapes = [(self.gain * self.half_scale_rad * x)[:, None]] * self.lines
        if self.bent:
            shapes.append(np.vander(x, len(_POWERS), increasing=True) @ _POWERS)
        return np.concatenate(shapes, axis=-1)


def encoder_waves(theta_rad: FloatArray) -> FloatArray:
    """Return the basis (..., `WAVES`) of an encoder's error: sine and cosine of the angle and of twice the angle."""
    double = 2.0 * theta_rad
    waves = np.sin(theta_rad), np.cos(theta_rad), np.sin(double), np.cos(double)
    return np.stack(waves, axis=-1)


def powers_of(curve: SensorCurve, coefficients: FloatArray) -> FloatArray:
    """Convert coefficients (width,) in the basis of `curve` to coefficients (11,), rad, of 1, x, ..., x^10."""
    powers = np.zeros(len(_POWERS))
    if curve.bent:
        powers += _POWERS @ coefficients[curve.lines :]
    powers[1] += curve.gain * curve.half_scale_rad * float(coefficients[: curve.lines].sum())
    return powers


def rms_per_amplitude() -> float:
    """Return the expected rms (over -1 <= x <= 1) of a sum of the weighted P2..P10 with coefficients ~ N(0, 1)."""
    degrees = np.arange(LOWEST, LOWEST + len(SHAPE_WEIGHTS))
    return float(np.sqrt((np.array(SHAPE_WEIGHTS) ** 2 / (2.0 * degrees + 1.0)).sum()))

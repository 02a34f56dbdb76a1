"""What an RVDT's readings deviate by, from the angle that the loop measures: line, curve, noise.

Knows sensors and measured angles; judges nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.sensors import Rvdt
from solver.diagnostics.loop_angles import LoopAngle
from solver.diagnostics.rvdt_noise import SingleNoise
from solver.diagnostics.smooth_curve import Scatter, SmoothCurve, fit_curve

TABLE_POINTS = 25
GRID_POINTS = 201

LEAST_BEND = 3
"""Degree of the simplest curve with a bow and an S."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RvdtFigures:
    """What was measured of one RVDT, over the range the poses cover.

    Attributes
    ----------
    covered
        Fraction of full scale that the poses cover.
    theta_off_rad
        Offset that makes the deviations average to zero over the covered range.
    gain
        Slope of the best-fit line, reading per true angle; 1 is right.
    linearity, linearity_sd
        Largest deviation from that line, fraction of full scale, and its standard deviation.
        From the line of all of full scale a curve may stray by more, and now and then by less.
    half_range
        Half the peak-to-peak deviation from unit gain, fraction of full scale.
    noise
        That of a single reading.
    loop_sd_rad
        How well the loop itself measures the angle of one pose (rms).
    line_probability
        Chance of so much curvature if the sensor were straight.
    angle_rad, deviation_rad
        (m,) true sensor angle and reading minus it, by pose.
    curve
        Deviation as a function of the true sensor angle.
    table_rad
        (k, 3): reading, correction to add to it, standard deviation of that correction. Corrected
        readings and `theta_off_rad` belong together.
    """

    covered: float
    theta_off_rad: float
    gain: float
    linearity: float
    linearity_sd: float
    half_range: float
    noise: SingleNoise
    loop_sd_rad: float
    line_probability: float
    angle_rad: FloatArray
    deviation_rad: FloatArray
    curve: SmoothCurve
    table_rad: FloatArray

    def corrected(self, reading_rad: FloatArray) -> FloatArray:
        """Correct readings by the curve; beyond the covered range by its end value."""
        angle = reading_rad - self.curve(np.clip(reading_rad, self.curve.low, self.curve.high))
        # The curve is known over the true angle: one more pass takes it there.
        return np.asarray(reading_rad - self.curve(np.clip(angle, self.curve.low, self.curve.high)))


def sensor_angle(reading_rad: FloatArray, measured: LoopAngle) -> tuple[FloatArray, float]:
    """Return the true angle in sensor coordinates (m,) and the mean offset taken off it, rad."""
    apart = measured.angle_rad - reading_rad
    # The middle one decides which turn is meant; no reading is off by half of one.
    middle = float(np.median(np.unwrap(apart)))
    turns = np.round((apart - middle) / (2.0 * np.pi))
    offset = float(np.mean(apart - 2.0 * np.pi * turns))
    return measured.angle_rad - 2.0 * np.pi * turns - offset, offset


def measure(
    reading_rad: FloatArray,
    measured: LoopAngle,
    sensor: Rvdt,
    of_loops: Scatter,
    noise: SingleNoise | None,
    samples: float,
) -> RvdtFigures:
    """Split the deviations of readings (m,) from the measured angles.

    Parameters
    ----------
    of_loops
        What scatters the measured angles.
    noise
        That of a single reading; None where nothing better tells of it than the scatter about the
        curve, which bounds it: the loop's own slow errors are in there too.
    samples
        Readings in each pose's mean.

    Raises
    ------
    ValueError
        If there are too few poses to fit any curve.
    """
    from scipy.special import chdtri

    angle, offset = sensor_angle(reading_rad, measured)
    deviation = reading_rad - angle
    curve = fit_curve(angle, deviation)
    grid = np.linspace(curve.low, curve.high, GRID_POINTS)
    fitted = curve(grid)
    # The constant belongs to theta_off: deviations average to zero over the covered range.
    constant = float(np.mean(fitted))
    bend, slope = _off_line(grid, fitted), _slope(grid, fitted)
    squares = float(curve.residual @ curve.residual)
    own = float(np.mean(measured.pose_variance))
    variance = max(squares / curve.dof - own, 0.0)
    if noise is None:
        most = max(squares / float(chdtri(curve.dof, 0.975)) - own, 0.0)
        lsb, high = (np.sqrt(np.array([variance, most]) * samples) / sensor.resolution_rad).tolist()
        noise = SingleNoise(lsb=lsb, low=0.0, high=high, from_spread=False)
    of_points = of_loops.also_own(variance)
    # A line that was chosen may hide a bend: its uncertainty is that of the bends it could hide.
    bendable = curve if curve.degree >= LEAST_BEND else fit_curve(angle, deviation, LEAST_BEND)
    off_line = _off_line(grid, bendable.by_points(grid))
    peak = int(np.argmax(np.abs(bend)))
    return RvdtFigures(
        covered=float(np.ptp(reading_rad) / sensor.full_scale_rad),
        theta_off_rad=offset - constant,
        gain=1.0 + slope,
        linearity=float(np.abs(bend[peak]) / sensor.full_scale_rad),
        linearity_sd=float(np.sqrt(of_points.variance_of(off_line).max()) / sensor.full_scale_rad),
        half_range=float(0.5 * np.ptp(fitted) / sensor.full_scale_rad),
        noise=noise,
        loop_sd_rad=float(np.sqrt(np.mean(of_loops.variance))),
        line_probability=curve.line_probability,
        angle_rad=angle + constant,
        deviation_rad=deviation - constant,
        curve=_shifted(curve, constant),
        table_rad=_table(curve, constant, of_points),
    )


def _slope(x: FloatArray, y: FloatArray) -> float:
    """Slope of the best-fit line through points (k,)."""
    across = x - x.mean()
    return float(across @ y / (across @ across))


def _off_line(x: FloatArray, y: FloatArray) -> FloatArray:
    """Values (k, ...) over x (k,) less their best-fit line."""
    across = x - x.mean()
    across /= np.linalg.norm(across)
    return np.asarray(y - y.mean(axis=0) - np.multiply.outer(across, across @ y))


def _shifted(curve: SmoothCurve, constant: float) -> SmoothCurve:
    """Return the curve with `constant` taken off its value and added to its abscissa."""
    coefficients = curve.coefficients.copy()
    coefficients[0] -= constant
    return SmoothCurve(
        low=curve.low + constant,
        high=curve.high + constant,
        coefficients=coefficients,
        smoother=curve.smoother,
        residual=curve.residual,
        dof=curve.dof,
        line_probability=curve.line_probability,
    )


def _table(curve: SmoothCurve, constant: float, of_points: Scatter) -> FloatArray:
    grid = np.linspace(curve.low, curve.high, TABLE_POINTS)
    by_points = curve.by_points(grid)
    deviation = curve(grid) - constant
    # Of its deviation from its own mean.
    sd = np.sqrt(of_points.variance_of(by_points - by_points.mean(axis=0)))
    return np.stack((grid + constant + deviation, -deviation, sd), axis=1)

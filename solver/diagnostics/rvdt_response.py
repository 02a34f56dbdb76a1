"""Errors of an RVDT relative to the angle that the closed loop measures: gain, linearity deviation and noise.

The deviation as a function of the angle is a Legendre series, whose degree is chosen by leave-one-out prediction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.sensors import DITHER, Rvdt
from solver.diagnostics.limits import NOISE_INTERVAL_RATIO
from solver.diagnostics.pose_adjustment import LoopAngle
from solver.diagnostics.statistics import chi2_limit
from solver.estimators.variance_components import Component

MAX_DEGREE = 8

POINTS_PER_TERM = 4
"""Smallest number of points per term with which the prediction error is meaningful."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothCurve:
    """Legendre series that was fitted by least squares to the values at m points.

    `low`, `high`: range of the points' abscissas. `coefficients`: (degree + 1,).
    `smoother` (degree + 1, m): maps the values to the coefficients.
    `residual` (m,): values minus curve. `dof`: number of points minus number of coefficients.
    `line_probability`: probability that noise makes the curve fit so much better than a straight line (F test, times
    the number of degrees compared). It is 1 if the fitted curve is a straight line.
    """

    low: float
    high: float
    coefficients: FloatArray
    smoother: FloatArray
    residual: FloatArray
    dof: int
    line_probability: float

    @property
    def degree(self) -> int:
        """Selected degree; 1 is a straight line."""
        return len(self.coefficients) - 1

    def __call__(self, abscissa: FloatArray) -> FloatArray:
        """Values of the curve at `abscissa`."""
        return np.asarray(_basis(abscissa, self.low, self.high, self.degree) @ self.coefficients)

    def by_points(self, abscissa: FloatArray) -> FloatArray:
        """Return the derivatives (k, m) of the curve at `abscissa` (k,) with respect to the m fitted values."""
        return np.asarray(_basis(abscissa, self.low, self.high, self.degree) @ self.smoother)


def fit_curve(abscissa: FloatArray, values: FloatArray, least_degree: int = 1) -> SmoothCurve:
    """Fit a Legendre series to points (m,); its degree is chosen by the leave-one-out error.

    So that noise is not fitted, a degree above `least_degree` must reduce the error of the best lower degree by more
    than the standard error of the reduction. It also needs `POINTS_PER_TERM` points per term of the series. At least
    ``2 * POINTS_PER_TERM`` points are needed in any case, and not all of them at one abscissa.
    """
    from scipy.special import fdtrc

    m = len(abscissa)
    low, high = float(abscissa.min()), float(abscissa.max())
    # Degrees are nested: each adds one direction to those of the degree below.
    most = max(least_degree, min(MAX_DEGREE, m // POINTS_PER_TERM - 1))
    nested = _basis(abscissa, low, high, most)
    Q, R = np.linalg.qr(nested)
    residuals = values[:, None] - np.cumsum(Q * (Q.T @ values), axis=1)
    leverages = np.cumsum(Q**2, axis=1)
    left_out = (residuals / np.maximum(1.0 - leverages, 1e-12)) ** 2
    best = 1
    for degree in range(2, most + 1):
        gain = left_out[:, best] - left_out[:, degree]
        error = float(gain.std() * np.sqrt(m))
        if degree <= least_degree or float(gain.sum()) > error:
            best = degree
    smoother = np.asarray(np.linalg.solve(R[: best + 1, : best + 1], Q[:, : best + 1].T))
    dof = m - best - 1
    chance = 1.0
    if best > 1:
        more = best - 1
        line, curve = (float(residuals[:, degree] @ residuals[:, degree]) for degree in (1, best))
        ratio = (line - curve) / more / max(curve / dof, 1e-300)
        chance = min(1.0, (most - 1) * float(fdtrc(more, dof, ratio)))
    return SmoothCurve(
        low=low,
        high=high,
        coefficients=smoother @ values,
        smoother=smoother,
        residual=residuals[:, best],
        dof=dof,
        line_probability=chance,
    )


def _basis(abscissa: FloatArray, low: float, high: float, degree: int) -> FloatArray:
    """Legendre polynomials (..., degree + 1) at `abscissa`, with the range from `low` to `high` mapped to [-1, 1]."""
    x = (2.0 * np.asarray(abscissa) - low - high) / (high - low)
    return np.asarray(np.polynomial.legendre.legvander(x, degree))


TABLE_POINTS = 25
GRID_POINTS = 201

LEAST_BEND = 3
"""Degree of the polynomial that gives the uncertainty of a straight line, because a line may hide a curvature."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RvdtFigures:
    """Measured properties of one RVDT, over the range that the poses cover.

    `covered`: fraction of full scale that the poses cover.
    `theta_off_rad`: offset that makes the deviations average to zero over the covered range.
    `gain`: slope of the best-fit line of the reading against the true angle; 1 means no error.
    `linearity`, `linearity_sd`: largest deviation from the best-fit line over the covered range, and its standard
    deviation, as fractions of full scale. Over the full scale it may be larger, but is rarely smaller.
    `half_range`: half the peak-to-peak deviation from a line of gain 1, as a fraction of full scale.
    `noise`: noise of a single reading.
    `loop_sd_rad`: standard deviation of the angles that the loop measures (rms over the poses).
    `line_probability`: probability that noise makes a linear sensor look so curved (see `SmoothCurve`).
    `angle_rad` (m,): true angle of the sensor in each pose. `deviation_rad` (m,): reading minus this angle.
    `curve`: deviation as a function of the true angle.
    `table_rad` (k, 3): each row has a reading, the correction to be added to it, and the standard deviation of the
    correction. Corrected readings have to be used with `theta_off_rad`.
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
        """Correct readings with the curve; beyond its range, the curve keeps its value at the nearer end."""
        angle = reading_rad - self.curve(np.clip(reading_rad, self.curve.low, self.curve.high))
        # The curve is a function of the true angle, so it is evaluated again at the corrected one.
        return np.asarray(reading_rad - self.curve(np.clip(angle, self.curve.low, self.curve.high)))


def sensor_angle(reading_rad: FloatArray, measured: LoopAngle) -> tuple[FloatArray, float]:
    """Return the readings (m,) of an exact sensor, and the offset (mean of joint angle theta' minus reading), rad."""
    apart = measured.angle_rad - reading_rad
    # The median decides on the whole turns; no reading is wrong by half a turn.
    middle = float(np.median(np.unwrap(apart)))
    turns = np.round((apart - middle) / (2.0 * np.pi))
    offset = float(np.mean(apart - 2.0 * np.pi * turns))
    return measured.angle_rad - 2.0 * np.pi * turns - offset, offset


def measure(
    reading_rad: FloatArray,
    measured: LoopAngle,
    sensor: Rvdt,
    noise: SingleNoise | None,
    samples: float,
) -> RvdtFigures:
    """Split the deviations of readings (m,) from the angles `measured` into gain, linearity deviation and noise.

    At least ``2 * POINTS_PER_TERM`` poses are needed.

    `noise`: noise of a single reading. If it is None, the scatter about the fitted curve is used. This overestimates
    the noise, as it includes slowly varying errors of the loop. `samples`: number of readings averaged at each pose.
    """
    angle, offset = sensor_angle(reading_rad, measured)
    deviation = reading_rad - angle
    curve = fit_curve(angle, deviation)
    # The constant is part of theta_off: deviations average to zero over the covered range.
    grid = np.linspace(curve.low, curve.high, GRID_POINTS)
    fitted = curve(grid)
    constant = float(np.mean(fitted))
    grid, fitted = grid + constant, fitted - constant
    angle, deviation = angle + constant, deviation - constant
    curve = replace(
        curve,
        low=curve.low + constant,
        high=curve.high + constant,
        coefficients=np.concatenate((curve.coefficients[:1] - constant, curve.coefficients[1:])),
    )
    about = grid - grid.mean()
    bend, slope = _off_line(grid, fitted), float(about @ fitted / (about @ about))
    squares = float(curve.residual @ curve.residual)
    own = float(np.mean(measured.own))
    variance = max(squares / curve.dof - own, 0.0)
    if noise is None:
        most = max(squares / float(chi2_limit(curve.dof, 0.975)) - own, 0.0)
        lsb, high = (np.sqrt(np.array([variance, most]) * samples) / sensor.resolution_rad).tolist()
        noise = SingleNoise(lsb=lsb, low=0.0, high=high, from_spread=False)
    of_points = replace(measured, own=measured.own + variance)
    # The uncertainty of a straight line includes the bends that it could hide.
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
        loop_sd_rad=float(np.sqrt(np.mean(measured.variance))),
        line_probability=curve.line_probability,
        angle_rad=angle,
        deviation_rad=deviation,
        curve=curve,
        table_rad=_table(curve, of_points),
    )


def _off_line(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the values `y` (k, ...) at the abscissas `x` (k,) minus their best-fit line."""
    across = x - x.mean()
    across /= np.linalg.norm(across)
    return np.asarray(y - y.mean(axis=0) - np.multiply.outer(across, across @ y))


def _table(curve: SmoothCurve, of_points: LoopAngle) -> FloatArray:
    grid = np.linspace(curve.low, curve.high, TABLE_POINTS)
    by_points, deviation = curve.by_points(grid), curve(grid)
    # Covariance of the deviation from its own mean.
    sd = np.sqrt(of_points.variance_of(by_points - by_points.mean(axis=0)))
    return np.stack((grid + deviation, -deviation, sd), axis=1)


TERMS = 200
"""Number of terms of the series in `spread_of`; the omitted rest is below 1e-3 LSB^2 even without any noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleNoise:
    """Noise of a single reading, without the error of rounding to whole LSB.

    `lsb`: standard deviation, LSB. `low`, `high`: its 95 % interval, LSB. `from_spread`: whether the noise follows
    from the spread of the samples within each pose; otherwise it follows from the closure errors.
    """

    lsb: float
    low: float
    high: float
    from_spread: bool

    @property
    def determined(self) -> bool:
        """Whether the interval is narrow enough to state a value; otherwise only the upper limit `high` is stated."""
        return self.low > 0.0 and self.high <= NOISE_INTERVAL_RATIO * self.low


def noise_of_component(sensor: Rvdt, component: Component) -> SingleNoise:
    """Return the noise of a single reading from the variance component that the fit of the loops estimated for it."""
    # Rounding is part of the component where the stated noise dithers it, and only there.
    rounding = 1.0 / 12.0 if sensor.noise_lsb >= DITHER else 0.0
    sizes = np.array([component.sd, component.low, component.high]) / sensor.resolution_rad
    lsb, low, high = np.sqrt(np.maximum(sizes**2 - rounding, 0.0)).tolist()
    return SingleNoise(lsb=lsb, low=low, high=high, from_spread=False)


def noise_of_samples(sd_lsb: FloatArray, samples: IntArray) -> SingleNoise:
    """Return the noise of a single reading from the samples at each pose; at least one pose has several samples.

    `sd_lsb`: standard deviation of the single readings at each pose (m,), LSB; 0 if not recorded.
    `samples`: number of readings averaged at each pose (m,).
    """
    weight = (samples - 1) / (samples - 1).sum()
    pooled = float(weight @ sd_lsb**2)
    # With noise below half an LSB, readings flicker at some poses only: the spreads scatter more than chi2 predicts.
    between = float(weight**2 @ (sd_lsb**2 - pooled) ** 2)
    dof = float((samples - 1).sum())
    if between > 0.0:
        dof = min(dof, 2.0 * pooled**2 / between)
    interval = (pooled * dof / chi2_limit(dof, np.array([0.025, 0.975]))).tolist()
    lsb, low, high = map(noise_of_spread, (pooled, *interval))
    return SingleNoise(lsb=lsb, low=low, high=high, from_spread=True)


def spread_of(noise_lsb: float) -> float:
    """Return the mean square spread S (LSB^2) of the rounded readings of a joint at rest, averaged over all angles.

    S is half the mean square difference of two readings. Rounding turns a true difference d into one of the two nearest
    integers, with mean square ``d^2 + f (1 - f)``, where f is the fractional part of d. As d is normal with variance
    ``2 noise^2``, averaging over d gives the Fourier series

        S = noise^2 + 1/12 - sum_k exp(-4 pi^2 k^2 noise^2) / (2 pi^2 k^2)

    S exceeds ``noise^2`` by 1/12 if the noise is large, and is 0 without noise.
    """
    k = np.arange(1, TERMS + 1)
    less = np.exp(-((2.0 * np.pi * k * noise_lsb) ** 2)) / (2.0 * np.pi**2 * k**2)
    return float(noise_lsb**2 + 1.0 / 12.0 - less.sum())


def noise_of_spread(mean_square: float) -> float:
    """Return the noise (LSB) for which rounded readings have this mean square spread (LSB^2): inverts `spread_of`."""
    if mean_square > 1.0 + 1.0 / 12.0:
        # From 1 LSB on the series is negligible: exp(-4 pi^2).
        return float(np.sqrt(mean_square - 1.0 / 12.0))
    least, most = 0.0, float(np.sqrt(mean_square)) + 1.0
    if mean_square <= spread_of(least):
        return 0.0
    for _ in range(50):
        middle = 0.5 * (least + most)
        least, most = (middle, most) if spread_of(middle) < mean_square else (least, middle)
    return 0.5 * (least + most)

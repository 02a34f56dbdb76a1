"""Errors that the arm file and the fixture file state.

Every source of error has a standard deviation; 0 means exact. In the linear mixed model (`solver.estimators.effects`) a
source is noise, which is independent from pose to pose, or an effect, which has one coefficient for all poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from solver.arrays import FloatArray, IntArray, select_poses
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import Parameter
from solver.chain.sensors import DITHER, Rvdt, SensorCurve
from solver.estimators.load_effects import LoadBasis

SD_OF_PEAK = 0.5
"""Sigma of the coefficients of a linearity deviation (`SensorCurve`), divided by the peak of the deviation."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AnalogueReading:
    """A sensor whose noise and linearity deviation are estimated together with the parameters; `joint` is 1-based.

    `variance`: stated variance of a single reading, rad^2.
    `share` (m,): variance of each pose's mean reading, divided by `variance`.
    `spread_variance`, `spread_dof`: pooled variance of the samples within each pose, rad^2, and its degrees of freedom;
    both 0 if the spread of the samples was not recorded.
    `curve`: basis functions of the sensor's systematic deviation; None if it has none.
    `curve_variance`: variance (rad^2) of the coefficients of `curve` according to the specification.
    """

    joint: int
    variance: float
    share: FloatArray
    spread_variance: float = 0.0
    spread_dof: int = 0
    curve: SensorCurve | None = None
    curve_variance: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorModel:
    """Errors of the readings of n joints at m poses, and of the fixture.

    `joint_variance` (m, n): variance of each pose's mean readings due to resolution and stated noise, rad^2.
    `analogue`: sensors whose noise is estimated; `joint_variance` does not include their noise.
    `endpoint_variance` (6,): variance of an instrument's readings of the end point, rad^2 then m^2; 0 if there is none.
    `accuracy_rad` (n,): standard deviation of each joint's encoder error, which has periods of one and half a turn.
    `backlash_rad`, `sag_rad` (n,): standard deviations of each joint's play and of its twist under load.
    `give_rad`, `give_m`: standard deviation of the deflection along each closure component; None without a fixture.
    `tolerance`: standard deviation (rad, m), by name, of each entry of the maker's table that the fit may correct.
    `prior`: standard deviation, by name, of each identified parameter whose uncertainty a file states.
    `distances`: measured distances between points of the loop.
    `discrepancy`: whether the fit also estimates a misfit of unknown source, as a smooth function of the pose.
    `loads`: effects of gravity; None without poses. Then joints do not sag, and the side of their play is unknown.
    `approach` (m, n): direction in which each joint approached the pose, 1 or -1; 0 if unknown.
    `signed`: whether joints are expected to sag in the direction of gravity; otherwise either side is equally likely.
    """

    joint_variance: FloatArray
    endpoint_variance: FloatArray = field(default_factory=lambda: np.zeros(6))
    analogue: tuple[AnalogueReading, ...] = ()
    accuracy_rad: FloatArray | None = None
    backlash_rad: FloatArray | None = None
    sag_rad: FloatArray | None = None
    give_rad: float | None = None
    give_m: float | None = None
    tolerance: Mapping[str, float] = field(default_factory=dict)
    prior: Mapping[str, float] = field(default_factory=dict)
    distances: tuple[MeasuredDistance, ...] = ()
    discrepancy: bool = False
    loads: LoadBasis | None = None
    approach: FloatArray | None = None
    signed: bool = True

    @property
    def curves(self) -> tuple[SensorCurve, ...]:
        """Linearity and gain errors of the analogue sensors that have such errors."""
        return tuple(a.curve for a in self.analogue if a.curve is not None)

    def at_poses(self, poses: IntArray) -> ErrorModel:
        """Return the error model of a selection of poses."""
        return replace(
            select_poses(self, poses, "joint_variance", "approach"),
            analogue=tuple(select_poses(a, poses, "share") for a in self.analogue),
            loads=None if self.loads is None else self.loads.at_poses(poses),
        )


def stated_errors(
    arm: ArmModel,
    *,
    samples: IntArray,
    sd_rad: FloatArray | None = None,
    unsensed_joints: tuple[int, ...] = (),
) -> ErrorModel:
    """Return the errors that the arm's file states, for poses at which readings are means of `samples` (m,) samples.

    `sd_rad` (m, n): standard deviation of the samples at each pose, rad; None if not recorded. `unsensed_joints`:
    joints (1-based) whose readings are not used, so that the noise of their sensors is not estimated.
    """
    variance = variance_of_means(arm, samples)
    analogue = []
    for j, joint in enumerate(arm.joints, 1):
        sensor = joint.sensor
        if not isinstance(sensor, Rvdt) or j in unsensed_joints:
            continue
        curve = SensorCurve(
            joint=j,
            middle_rad=joint.middle_rad,
            half_scale_rad=0.5 * sensor.full_scale_rad,
            gain=sensor.gain,
            bent=sensor.linearity > 0.0,
        )
        rounding = sensor.resolution_rad**2 / 12.0
        dithered = sensor.noise_lsb >= DITHER
        # Rounding averages out only if noise dithers it.
        variance[:, j - 1] = 0.0 if dithered else rounding
        stated = sensor.sigma_rad**2 - (0.0 if dithered else rounding)
        spread, dof = (0.0, 0) if sd_rad is None else _spread(sd_rad[:, j - 1], samples)
        analogue.append(
            AnalogueReading(
                joint=j,
                variance=stated,
                share=1.0 / samples,
                spread_variance=spread,
                spread_dof=dof,
                curve=curve if curve.width else None,
                curve_variance=(SD_OF_PEAK * sensor.linearity_rad) ** 2,
            )
        )
    return ErrorModel(
        joint_variance=variance,
        analogue=tuple(analogue),
        accuracy_rad=arm.accuracy_rad,
        backlash_rad=arm.backlash_rad,
        sag_rad=arm.sag_rad,
    )


def variance_of_means(arm: ArmModel, samples: IntArray) -> FloatArray:
    """Return the variance (m, n), rad^2, of the mean of `samples` (m,) readings, from the sensors' specifications."""
    counts, which = np.unique(samples, return_inverse=True)
    by_count = [[j.sensor.variance_of_mean_rad2(int(k)) for j in arm.joints] for k in counts]
    return np.array(by_count).reshape(-1, arm.joint_count)[which]


def _spread(sd_rad: FloatArray, samples: IntArray) -> tuple[float, int]:
    """Return the pooled variance (rad^2) of the samples within each pose and its dof; (0, 0) if not recorded."""
    dof = int((samples - 1).sum())
    if dof == 0 or not np.any(sd_rad):
        return 0.0, 0
    return float(((samples - 1) * sd_rad**2).sum() / dof), dof


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredDistance:
    """Measured distance and its uncertainty, m. `first`, `second`: names of the coordinates of its two end points."""

    first: tuple[str, ...]
    second: tuple[str, ...]
    value_m: float
    sigma_m: float


def distance_and_rates(
    first: Sequence[int], second: Sequence[int], x: FloatArray
) -> tuple[float, FloatArray]:
    """Return the distance, m, between points x[first] and x[second], and its derivatives (P,) with respect to x."""
    apart = x[list(second)] - x[list(first)]
    value = float(np.linalg.norm(apart))
    rates = np.zeros_like(x)
    rates[list(second)] = apart / max(value, 1e-300)
    rates[list(first)] = -rates[list(second)]
    return value, rates


def distance_rows(
    distances: Sequence[MeasuredDistance], parameters: Sequence[Parameter], x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the misclosures (k,) of k `distances` at x (P,) and their derivatives (k, P), each divided by its sigma s.

    The linearised equation of a distance d from point p_a to p_b is ``(d(x) - d_measured) / s + u . (dp_b - dp_a) / s =
    0``, where dp_a and dp_b are the steps of the points, and ``u = (p_b - p_a) / d``.
    """
    index = {p.name: k for k, p in enumerate(parameters)}
    w, rows = np.zeros(len(distances)), np.zeros((len(distances), len(x)))
    for k, d in enumerate(distances):
        a, b = ([index[name] for name in names] for names in (d.first, d.second))
        value, rates = distance_and_rates(a, b, x)
        w[k] = (value - d.value_m) / d.sigma_m
        rows[k] = rates / d.sigma_m
    return w, rows

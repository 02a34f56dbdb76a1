"""Verdict on an RVDT: what it reads against what the closed loop measures of its joint.

With the wrist joints eliminated as unsensed the loop measures their true angles itself. Line, curve
and noise of the readings (`solver.judging.rvdt_figures`) are held against the specification here, and put
into plain words. Knows sensors and closure models; no fixture and no screen.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import wrap_angle
from solver.chain.sensors import Rvdt
from solver.estimators.error_model import ErrorModel
from solver.estimators.variance_components import estimate_with_errors
from solver.judging.loop_angles import LoopAngle, loop_angles
from solver.judging.rvdt_figures import RvdtFigures, measure, sensor_angle
from solver.loops.closure import ClosureModel

MIN_POSES = 15
MIN_SPAN = 0.15
"""Fraction of full scale that poses must cover before a curve can be told from a line."""

LEVEL = 0.01
"""Chance of calling a straight sensor curved."""

TWO_SIDED = 1.959963984540054

NOISE_MARGIN = 1.25
"""Noise is out of specification when it is above it by more than this for certain: 60 poses know
their own noise to a tenth, and a specification in whole LSB means no more.
"""

HARMFUL = 3.0
"""A curve this many times the sensor's noise spoils what the other joints' encoders know."""


class Verdict(Enum):
    """What the loop says of an RVDT."""

    SOUND = "sound"
    CURVED = "curved, within specification"
    OUT_OF_SPECIFICATION = "out of specification"
    CANNOT_DECIDE = "cannot decide"


@dataclass(frozen=True, slots=True, kw_only=True)
class RvdtVerdict:
    """One joint's RVDT.

    Attributes
    ----------
    joint
        1-based.
    verdict, text
        The verdict, and the same in plain words with the numbers behind it.
    treat_as_unsensed
        Whether the joint's reading does the calibration more harm than good.
    share
        Share of the squared closure error at the readings that correcting this joint removes
        (0..1, negative if it grows); 0 when the poses cannot decide.
    figures
        What was measured; None when the poses cannot decide.
    """

    joint: int
    verdict: Verdict
    text: str
    treat_as_unsensed: bool
    share: float
    figures: RvdtFigures | None


def rvdt_verdicts(
    model: ClosureModel,
    arm: ArmModel,
    q: FloatArray,
    errors: ErrorModel,
    *,
    x0: FloatArray | None = None,
) -> tuple[RvdtVerdict, ...]:
    """Judge every RVDT among the unsensed joints of `model` by readings `q` (m, n), rad.

    Parameters
    ----------
    model
        One placement's loop with the RVDT joints unsensed, so that their readings take no part.
    errors
        What is stated of all other sources, which would pass for noise of the RVDT.

    Raises
    ------
    TooFewPosesError
        No degree of freedom would be left.
    ValueError
        If no unsensed joint of `model` has an RVDT.
    """
    sensors = {
        j: sensor
        for j in model.unsensed_joints
        if isinstance(sensor := arm.joints[j - 1].sensor, Rvdt)
    }
    if not sensors:
        raise ValueError("none of the model's unsensed joints has an RVDT to judge")
    whole = estimate_with_errors(model, q, errors, x0=x0)
    estimate, found = whole.estimate, whole.components
    angles = {a.joint: a for a in loop_angles(model, estimate.x, q, found.noise)}
    # A fixture that turns looks like noise of the wrist, and no pose tells the two apart: where it
    # gives at all, none of the scatter is held against the sensor.
    gives = found.flexure is not None and found.flexure.gives
    offsets = {j: sensor_angle(q[:, j - 1], a)[1] for j, a in angles.items()}
    verdicts = []
    for joint, sensor in sensors.items():
        reading, angle = q[:, joint - 1], angles[joint]
        reason = _undecidable(reading, angle, sensor, estimate.covariance)
        if not estimate.converged:
            reason = "the calibration without the RVDTs did not converge"
        if reason:
            verdicts.append(_undecided(joint, reason))
            continue
        own = np.inf if gives else float(np.mean(angle.pose_variance))
        figures = measure(reading, angle, sensor, estimate.covariance, most_loop_variance=own)
        here = offsets | {joint: figures.theta_off_rad}
        share = _share(model, estimate.x, q, joint, figures, here)
        verdicts.append(_judge(joint, sensor, figures, share))
    return tuple(verdicts)


def _undecidable(
    reading: FloatArray, angle: LoopAngle, sensor: Rvdt, parameter_covariance: FloatArray
) -> str:
    """Why these poses cannot tell; empty when they can."""
    if len(reading) < MIN_POSES:
        return f"{len(reading)} poses are too few, {MIN_POSES} are needed"
    span = float(np.ptp(reading) / sensor.full_scale_rad)
    if span < MIN_SPAN:
        return (
            f"the joint turned through {100.0 * span:.0f} % of full scale only, "
            f"{100.0 * MIN_SPAN:.0f} % are needed"
        )
    sd = float(np.sqrt(np.mean(np.diagonal(angle.covariance(parameter_covariance)))))
    if sd > 0.5 * sensor.linearity_rad:
        return (
            f"the loop measures the joint's angle to {1e3 * sd:.1f} mrad only, "
            f"where the specification allows {1e3 * sensor.linearity_rad:.1f} mrad"
        )
    return ""


def _undecided(joint: int, reason: str) -> RvdtVerdict:
    return RvdtVerdict(
        joint=joint,
        verdict=Verdict.CANNOT_DECIDE,
        text=f"RVDT of joint {joint}: cannot decide: {reason}",
        treat_as_unsensed=False,
        share=0.0,
        figures=None,
    )


def _judge(joint: int, sensor: Rvdt, figures: RvdtFigures, share: float) -> RvdtVerdict:
    curved = figures.line_probability < LEVEL
    too_curved = figures.linearity - TWO_SIDED * figures.linearity_sd > sensor.linearity
    too_noisy = figures.noise_low > NOISE_MARGIN * sensor.noise_lsb
    rms = float(np.sqrt(np.mean(figures.deviation_rad**2)))
    # The loop must know the angle better than the sensor reads it, or there is nothing to gain.
    harmful = (curved or too_noisy) and rms > HARMFUL * max(sensor.sigma_rad, figures.loop_sd_rad)
    if too_curved or too_noisy:
        verdict = Verdict.OUT_OF_SPECIFICATION
    elif curved:
        verdict = Verdict.CURVED
    else:
        verdict = Verdict.SOUND
    return RvdtVerdict(
        joint=joint,
        verdict=verdict,
        text=_words(joint, sensor, figures, share, verdict, harmful=harmful),
        treat_as_unsensed=harmful,
        share=share,
        figures=figures,
    )


def _words(
    joint: int,
    sensor: Rvdt,
    figures: RvdtFigures,
    share: float,
    verdict: Verdict,
    *,
    harmful: bool,
) -> str:
    allowed = f"specification {100.0 * sensor.linearity:.2g} %"
    covered = f"over the {100.0 * figures.covered:.0f} % that the poses cover"
    parts = [
        f"RVDT of joint {joint}: {verdict.value}",
        f"linearity {100.0 * figures.linearity:.2f} % of full scale ({allowed}) {covered}",
        f"gain {figures.gain:.4f}",
    ]
    if figures.noise_low > 0.0:
        parts.append(f"noise {figures.noise_lsb:.1f} LSB (specification {sensor.noise_lsb:g})")
    else:
        parts.append(
            f"noise below {figures.noise_high:.1f} LSB, not told from the loop's own "
            f"{1e3 * figures.loop_sd_rad:.2g} mrad"
        )
    if verdict is not Verdict.SOUND and share > 0.0:
        parts.append(f"explains {100.0 * share:.0f} % of the squared closure error")
    if harmful:
        parts.append(f"treat joint {joint} as unsensed, or correct its readings by the table")
    return "; ".join(parts)


def _share(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    joint: int,
    figures: RvdtFigures,
    offsets_rad: dict[int, float],
) -> float:
    """Share of the squared closure error, all readings used, that correcting one joint removes."""
    sensed = model.with_all_joints_sensed()
    known = {p.name: value for p, value in zip(model.parameters, x, strict=True)}
    known |= {f"theta_off_{j}": float(wrap_angle(v)) for j, v in offsets_rad.items()}
    whole = np.array([known.get(p.name, p.nominal) for p in sensed.parameters])
    better = q.copy()
    better[:, joint - 1] = figures.corrected(q[:, joint - 1])
    before, after = (float((sensed.reduced(whole, r).residual ** 2).sum()) for r in (q, better))
    return 0.0 if before == 0.0 else 1.0 - after / before

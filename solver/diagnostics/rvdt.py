"""Compares an RVDT's readings with the angle that the closed loop measures."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.parameters import DhEntry, DhKind, nominal_vector, wrap_angle
from solver.chain.poses import back_to_caller
from solver.chain.sensors import Rvdt
from solver.diagnostics import limits
from solver.diagnostics.fault_models import PeakDeviation
from solver.diagnostics.pose_adjustment import LoopAngle, loop_angles
from solver.diagnostics.rvdt_response import RvdtFigures, SingleNoise, measure, sensor_angle
from solver.estimators.error_model import ErrorModel
from solver.estimators.layout import Layout
from solver.estimators.mixed_fit import FitStart
from solver.estimators.variance_components import Calibrated, compliance_test, noise_left, settle
from solver.loops.closure import ClosureModel

NOISY = "check its plug, screen and excitation, or average more samples per pose"


class Soundness(Enum):
    """Condition of an RVDT, determined from the loop."""

    SOUND = "sound"
    CURVED = "curved, within specification"
    OUT_OF_SPECIFICATION = "out of specification"
    CANNOT_DECIDE = "cannot decide"


@dataclass(frozen=True, slots=True, kw_only=True)
class RvdtVerdict:
    """Verdict on one joint's RVDT.

    `joint`: 1-based. `text`: the verdict in words, with its figures.
    `treat_as_unsensed`: whether the calibration is better without the joint's reading.
    `share`: share of the squared closure error that disappears if this joint's readings are corrected (at most 1,
    negative if the error grows); 0 if the poses cannot decide.
    `figures`: measured figures; None if the poses cannot decide.
    `noise`: noise of a single reading; None if it is unknown. It may be known even if the poses cannot decide.
    """

    joint: int
    verdict: Soundness
    text: str
    treat_as_unsensed: bool = False
    share: float = 0.0
    figures: RvdtFigures | None = None
    noise: SingleNoise | None = None


def rvdt_verdicts(
    model: ClosureModel,
    sensors: Mapping[int, Rvdt],
    q: FloatArray,
    errors: ErrorModel,
    calibrated: Calibrated,
    *,
    noise: Mapping[int, SingleNoise],
    samples: IntArray,
) -> tuple[RvdtVerdict, ...]:
    """Test the RVDTs `sensors`, by joint (1-based), with readings `q` (m, n), rad.

    Raises `TooFewPosesError` if no degree of freedom would be left.

    `model`: loop in one placement of the fixture. The RVDTs' joints are unsensed, so their readings are not used.
    `errors`: stated errors of all other sources, which would otherwise look like noise of the RVDT.
    `calibrated`: fit of these poses that used the RVDTs' readings. The fit without these readings starts from the same
    parameters, and uses the same variances of the other sources. A variance below its start value is replaced by the
    start value, because `calibrated` may have attributed part of this error to the RVDT.
    `noise`: noise of single readings by joint (1-based), if known.
    `samples`: number of readings averaged at each pose (m,).
    """

    def at_least_stated(design: Layout) -> FloatArray:
        variances = calibrated.components.variances
        return np.array([max(c.start, variances.get(c.name, 0.0)) for c in design.components])

    x0 = nominal_vector(model.parameters, calibrated.estimate.values_by_name)
    near = _beside(calibrated, model, q)
    fitted, order = settle(model, q, errors, x0=x0, near=near, variances=at_least_stated)
    back = back_to_caller(order)
    angles = loop_angles(
        model,
        fitted.x,
        fitted.fit.covariance,
        q,
        noise_left(fitted, back),
        near=(fitted.corrections[back], fitted.unsensed[back]),
    )
    # A rotation of the fixture under load looks like noise of the wrist's sensors, and no pose separates the two.
    # If the fixture deflects more than stated, it may have caused all noise that follows from closure errors.
    uncertain = {j: replace(one, low=0.0) for j, one in noise.items() if not one.from_spread}
    compliance = compliance_test(fitted.fit.stated, fitted.fit.design) if uncertain else None
    if compliance is not None and compliance.deflects:
        noise = {**noise, **uncertain}
    sensed = model.with_all_joints_sensed()
    known = dict(zip((p.name for p in model.parameters), fitted.x.tolist(), strict=True))
    for j, angle in angles.items():
        known[f"theta_off_{j}"] = float(wrap_angle(sensor_angle(q[:, j - 1], angle)[1]))
    verdicts = []
    for joint, sensor in sensors.items():
        reading, angle = q[:, joint - 1], angles[joint]
        reason = _undecidable(reading, angle, sensor)
        if not fitted.converged:
            reason = "the calibration without the RVDTs did not converge"
        if reason:
            verdicts.append(undecided(joint, sensor, reason, noise.get(joint)))
            continue
        figures = measure(
            reading, angle, sensor, noise.get(joint), samples=float(1.0 / np.mean(1.0 / samples))
        )
        share = _share(sensed, known, q, joint, figures)
        verdicts.append(_verdict(joint, sensor, figures, share))
    return tuple(verdicts)


def _beside(calibrated: Calibrated, model: ClosureModel, q: FloatArray) -> FitStart:
    """Return a start for the fit of `model`, taken from the fit `calibrated`, which has fewer unsensed joints."""
    estimate, had = calibrated.estimate, calibrated.linear.design.model.unsensed_joints
    corrections = np.zeros_like(q) if estimate.corrections is None else estimate.corrections.copy()
    own = calibrated.unsensed.shape[-1] - len(had)
    known = estimate.values_by_name
    nominal = model.arm_rows()[DhKind.THETA_OFF].tolist()
    angles = [calibrated.unsensed[:, :own]]
    for j in model.unsensed_joints:
        if j in had:
            angles.append(calibrated.linear.design.model.angle_of(calibrated.unsensed, j)[:, None])
        else:
            offset = known.get(DhEntry(DhKind.THETA_OFF, j).name, nominal[j - 1])
            at = q[:, j - 1] + corrections[:, j - 1] + offset
            angles.append(at[:, None])
            corrections[:, j - 1] = 0.0
    return FitStart(
        corrections=corrections,
        unsensed=np.concatenate(angles, axis=-1),
        layout=calibrated.linear.design,
    )


def _undecidable(reading: FloatArray, measured: LoopAngle, sensor: Rvdt) -> str:
    if len(reading) < limits.RVDT_LEAST_POSES:
        return f"{len(reading)} poses are too few, {limits.RVDT_LEAST_POSES} are needed"
    span = float(np.ptp(reading) / sensor.full_scale_rad)
    if span < limits.RVDT_LEAST_SPAN:
        return (
            f"the joint turned through only {100.0 * span:.0f} % of full scale, "
            f"{100.0 * limits.RVDT_LEAST_SPAN:.0f} % are needed"
        )
    sd = float(np.sqrt(np.mean(measured.variance)))
    if sd > 0.5 * sensor.linearity_rad:
        return (
            f"the loop measures the joint's angle only to {1e3 * sd:.1f} mrad, "
            f"but the specification allows {1e3 * sensor.linearity_rad:.1f} mrad"
        )
    return ""


def undecided(joint: int, sensor: Rvdt, reason: str, noise: SingleNoise | None) -> RvdtVerdict:
    """Return the verdict on an RVDT whose curve these poses do not determine, with the reason, and noise if known."""
    noisy = noise is not None and _too_noisy(noise, sensor)
    verdict = Soundness.OUT_OF_SPECIFICATION if noisy else Soundness.CANNOT_DECIDE
    noise_texts = [] if noise is None else _noise_words(noise, sensor)
    curve = f"its curve is not determined: {reason}"
    return RvdtVerdict(
        joint=joint,
        verdict=verdict,
        text=f"RVDT of joint {joint}: "
        + "; ".join([verdict.value, *noise_texts, curve] if noisy else [curve, *noise_texts]),
        noise=noise,
    )


def _too_noisy(noise: SingleNoise, sensor: Rvdt) -> bool:
    return noise.low > limits.RVDT_NOISE_RATIO * sensor.noise_lsb


def linearity_deviation(figures: RvdtFigures, sensor: Rvdt) -> PeakDeviation:
    """Return the largest deviation of an RVDT from its best-fit line over the covered range, rad."""
    scale = sensor.full_scale_rad
    return PeakDeviation(
        peak=scale * figures.linearity, sd=scale * figures.linearity_sd, from_line=True
    )


def _verdict(joint: int, sensor: Rvdt, figures: RvdtFigures, share: float) -> RvdtVerdict:
    curved = figures.line_probability < limits.CURVATURE_FALSE_ALARM_PROBABILITY
    too_curved = linearity_deviation(figures, sensor).beyond(sensor.linearity_rad)
    too_noisy = _too_noisy(figures.noise, sensor)
    rms = float(np.sqrt(np.mean(figures.deviation_rad**2)))
    # The loop must measure the angle better than the sensor does; otherwise there is nothing to gain.
    harmful = (curved or too_noisy) and rms > limits.RVDT_HARMFUL_RATIO * max(
        sensor.sigma_rad, figures.loop_sd_rad
    )
    verdict = Soundness.CURVED if curved else Soundness.SOUND
    if too_curved or too_noisy:
        verdict = Soundness.OUT_OF_SPECIFICATION
    allowed, head = f"specification {100.0 * sensor.linearity:.2g} %", verdict.value
    if figures.linearity > sensor.linearity:
        allowed = f"sigma {100.0 * figures.linearity_sd:.2f} %, {allowed}"
        if verdict is Soundness.CURVED:
            head = "curved, but not significantly beyond its specification"
    covered = f"over the {100.0 * figures.covered:.0f} % of full scale that the poses cover"
    parts = [
        f"RVDT of joint {joint}: {head}",
        f"linearity {100.0 * figures.linearity:.2f} % of full scale ({allowed}) {covered}",
        f"gain {figures.gain:.4f}",
    ]
    parts += _noise_words(figures.noise, sensor)
    if verdict is not Soundness.SOUND and share > 0.0:
        parts.append(f"explains {100.0 * share:.0f} % of the squared closure error")
    if harmful:
        parts.append(f"treat joint {joint} as unsensed, or correct its readings by the table")
    return RvdtVerdict(
        joint=joint,
        verdict=verdict,
        text="; ".join(parts),
        treat_as_unsensed=harmful,
        share=share,
        figures=figures,
        noise=figures.noise,
    )


def _noise_words(noise: SingleNoise, sensor: Rvdt) -> list[str]:
    allowed = f"specification {sensor.noise_lsb:g} LSB"
    noisy = _too_noisy(noise, sensor)
    if noise.determined or noisy:
        size = f"{noise.lsb:.1f}" if noise.determined else f"{noise.low:.1f} to {noise.high:.1f}"
        text = f"noise of a single reading {size} LSB ({allowed})"
        return [text, NOISY] if noisy else [text]
    most = f"below {noise.high:.1f} LSB ({allowed})"
    text = f"noise of a single reading: not determined by these poses, {most}"
    remedy = "to measure it, record several samples per pose with their sd"
    return [text, remedy] if noise.high > limits.RVDT_NOISE_RATIO * sensor.noise_lsb else [text]


def _share(
    sensed: ClosureModel, known: dict[str, float], q: FloatArray, joint: int, figures: RvdtFigures
) -> float:
    """Return the share of the squared closure error that disappears if `figures` correct the joint's readings."""
    known = known | {f"theta_off_{joint}": float(wrap_angle(figures.theta_off_rad))}
    x = nominal_vector(sensed.parameters, known)
    better = q.copy()
    better[:, joint - 1] = figures.corrected(q[:, joint - 1])
    residual = sensed.reduced(x, np.stack((q, better)), rates=False).residual
    before, after = (residual**2).sum((1, 2)).tolist()
    return 0.0 if before == 0.0 else 1.0 - after / before

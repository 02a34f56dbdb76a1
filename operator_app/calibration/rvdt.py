"""Tests of an arm's RVDTs, corrections of their readings, and offsets of joints whose readings are not used."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from operator_app.calibration.error_model import free_within_tolerance
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.findings import motion_limit_rad
from operator_app.calibration.result import Solution
from operator_app.calibration.tool_accuracy import MeasuredOffset
from operator_app.config.parameter_records import RvdtRemedy
from operator_app.messages.finding import Finding, FindingKind
from operator_app.units import joints_named
from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import wrap_angle
from solver.chain.poses import PoseSet, back_to_caller
from solver.chain.sensors import NoSensor, Rvdt
from solver.closing import close_loops
from solver.diagnostics.fault_models import PeakDeviation
from solver.diagnostics.identifiability import identifiability_of_fit
from solver.diagnostics.rvdt import (
    RvdtVerdict,
    Soundness,
    linearity_deviation,
    rvdt_verdicts,
    undecided,
)
from solver.diagnostics.rvdt_response import (
    SingleNoise,
    noise_of_component,
    noise_of_samples,
)
from solver.diagnostics.stated_sizes import sensor_noise_with_estimated_motion
from solver.estimators.variance_components import Calibrated, components
from solver.loops.closure import ClosureModel


def check_rvdts(
    experiment: Experiment,
    kept: BoolArray,
    distinct: IntArray,
    calibrated: Calibrated,
    *,
    fixed: tuple[str, ...],
) -> tuple[RvdtVerdict, ...]:
    """Test the noise of every RVDT and, if there is a single placement, its readings against the loops.

    `calibrated`: fit of the `distinct` poses (k,) with the RVDTs' readings; start of the fit without these readings.
    """
    arm, poses = experiment.arm, experiment.poses
    sensors = {
        j: joint.sensor for j, joint in enumerate(arm.joints, 1) if isinstance(joint.sensor, Rvdt)
    }
    if not sensors:
        return ()
    noise = _noise_of_rvdts(sensors, poses, kept, calibrated)

    def none_decided(reason: str) -> tuple[RvdtVerdict, ...]:
        return tuple(undecided(j, s, reason, noise.get(j)) for j, s in sensors.items())

    if len(poses.placements) > 1:
        return none_decided("an RVDT is tested with one placement only: solve one placement alone")
    blind = tuple(sorted({*sensors, *experiment.unsensed}))
    model = replace(experiment, unsensed=blind).loop().at_poses(distinct).without(fixed)
    q = poses.q_rad[distinct]
    without = f"without the readings of {joints_named(tuple(sensors))}"
    if len(q) * model.equations_per_pose <= len(model.parameters):
        return none_decided(f"{without}, these poses are too few: take more")
    names = tuple(p.name for p in model.parameters)
    unseen = identifiability_of_fit(
        calibrated.linear, names, taken=calibrated.order, without=tuple(sensors)
    ).directions
    if unseen:
        blurred = ", ".join(dict.fromkeys(d.parameters[0] for d in unseen))
        return none_decided(
            f"{without}, these poses do not determine {blurred}: test it in the hinge"
        )
    model, tolerance = free_within_tolerance(model, arm, fixed=fixed)
    # The loads are the same whether a joint's reading is used or not.
    errors = calibrated.linear.design.errors.at_poses(back_to_caller(calibrated.order))
    errors = replace(
        errors,
        analogue=tuple(a for a in errors.analogue if a.joint not in blind),
        tolerance=tolerance,
        prior={p.name: errors.prior[p.name] for p in model.parameters if p.name in errors.prior},
    )
    return rvdt_verdicts(
        model, sensors, q, errors, calibrated, noise=noise, samples=poses.sample_counts[distinct]
    )


def _noise_of_rvdts(
    sensors: Mapping[int, Rvdt], poses: PoseSet, kept: BoolArray, calibrated: Calibrated
) -> dict[int, SingleNoise]:
    """Return the noise of a single reading of each RVDT, by joint; RVDTs whose noise cannot be determined are missing.

    The noise follows from the spread of the samples at each pose or, if there is none, from the closure. Poses in
    which a joint moved while it was read are left out; `motion_causes` reports them.
    """
    samples = poses.sample_counts[kept]
    # A spread of 0 counts as not recorded.
    spread = np.zeros_like(poses.q_rad[kept]) if poses.sd_rad is None else poses.sd_rad[kept]
    noise: dict[int, SingleNoise] = {}
    for j, sensor in sensors.items():
        own = spread[:, j - 1]
        still = own <= motion_limit_rad(sensor, own)
        if own[still & (samples > 1)].any():
            noise[j] = noise_of_samples(own[still] / sensor.resolution_rad, samples[still])
    if len(noise) < len(sensors):
        # The motion noise of fixture and joints is the estimated one, not the stated one.
        v, error = sensor_noise_with_estimated_motion(calibrated.linear)
        by_name = {c.name: c for c in components(calibrated.linear.design, v, error)}
        for j in sensors.keys() - noise.keys():
            if (component := by_name.get(f"rvdt_{j}")) is not None:
                noise[j] = noise_of_component(sensors[j], component)
    return noise


def measured_deviations(
    verdicts: tuple[RvdtVerdict, ...], arm: ArmModel
) -> dict[int, PeakDeviation]:
    """Linearity deviations, by joint, of the RVDTs for which they could be determined from the loops."""
    return {
        v.joint: linearity_deviation(v.figures, sensor)
        for v in verdicts
        if v.figures is not None and isinstance(sensor := arm.joints[v.joint - 1].sensor, Rvdt)
    }


def rvdt_causes(verdicts: tuple[RvdtVerdict, ...], arm: ArmModel) -> tuple[Finding, ...]:
    """Return findings of RVDTs that are out of specification; the sigmas of the parameters include these errors."""
    deviations, causes = measured_deviations(verdicts, arm), list[Finding]()
    for v in verdicts:
        if v.verdict is not Soundness.OUT_OF_SPECIFICATION:
            continue
        deviation, stated_rad = (
            deviations.get(v.joint),
            arm.joints[v.joint - 1].sensor.linearity_rad,
        )
        kind = FindingKind.RVDT_OUT_NOISE
        if deviation is not None and deviation.beyond(stated_rad):
            kind = FindingKind.RVDT_OUT_LINEARITY
        elif v.noise is not None and v.noise.from_spread:
            kind = FindingKind.RVDT_OUT_SPREAD
        causes.append(Finding(kind, joint=v.joint, sensor="RVDT", reported=(v.text,)))
    return tuple(causes)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingTable:
    """Corrections of the readings of one joint.

    `joint`: 1-based. `theta_off_rad`: offset to be used with corrected readings.
    `gain`: change of reading per change of angle, ideally 1. Its error is already part of the corrections.
    `reading_rad` (k,): readings in rising order. `add_rad` (k,): correction to be added at each reading, interpolated
    linearly between readings. `sigma_rad` (k,): standard uncertainty of each correction.
    """

    joint: int
    theta_off_rad: float
    gain: float
    reading_rad: FloatArray
    add_rad: FloatArray
    sigma_rad: FloatArray

    @classmethod
    def of(cls, remedy: RvdtRemedy) -> ReadingTable:
        """Return the corrections of one joint that a parameters file states in the record `remedy`."""
        rows = [(row.reading_deg, row.add_deg, row.sigma_deg) for row in remedy.table]
        reading, add, sigma = np.deg2rad(rows).T
        return cls(
            joint=remedy.joint,
            theta_off_rad=math.radians(remedy.theta_off_deg),
            gain=remedy.gain,
            reading_rad=reading,
            add_rad=add,
            sigma_rad=sigma,
        )

    def corrected(self, reading_rad: FloatArray) -> FloatArray:
        """Return corrected readings; outside the table's range, the correction at its nearer end is added."""
        return np.asarray(reading_rad + np.interp(reading_rad, self.reading_rad, self.add_rad))

    def beyond(self, reading_rad: FloatArray) -> int:
        """Number of readings outside the table's range."""
        low, high = self.reading_rad[[0, -1]]
        return int(np.sum((reading_rad < low) | (reading_rad > high)))


def reading_tables(solution: Solution) -> tuple[ReadingTable, ...]:
    """Return the corrections of every RVDT that the poses could determine."""
    tables = []
    for verdict in solution.rvdt:
        figures = verdict.figures
        if figures is None or not figures.gain > 0.0:
            continue
        reading, add, sigma = figures.table_rad.T
        # Where readings decrease with rising angle, a correction by reading is not unique.
        rising = reading > np.maximum.accumulate(np.concatenate(([-np.inf], reading[:-1])))
        if rising.sum() < 2:
            continue
        tables.append(
            ReadingTable(
                joint=verdict.joint,
                theta_off_rad=float(wrap_angle(figures.theta_off_rad)),
                gain=figures.gain,
                reading_rad=reading[rising],
                add_rad=add[rising],
                sigma_rad=sigma[rising],
            )
        )
    return tuple(tables)


def corrected_poses(poses: PoseSet, tables: Sequence[ReadingTable]) -> PoseSet:
    """Return poses with the readings of some joints corrected."""
    q = poses.q_rad.copy()
    for table in tables:
        q[:, table.joint - 1] = table.corrected(q[:, table.joint - 1])
    return replace(poses, q_rad=q)


def measured_offsets(
    model: ClosureModel, x: FloatArray, q: FloatArray, arm: ArmModel
) -> dict[int, MeasuredOffset]:
    """Offset of each joint that has a sensor but whose readings were not used, by joint.

    `x`, `q`: identified parameters (P,), and readings (m, n) of their poses, rad and m.
    """
    joints = [
        j for j in model.unsensed_joints if not isinstance(arm.joints[j - 1].sensor, NoSensor)
    ]
    if not joints:
        return {}
    closed, (*_, last) = close_loops(model, x, q), model.parts()[-1]
    offsets = {}
    for j in joints:
        # The zeros of the first and the last joint count from the fixture, so each placement has its own.
        poses = last if j in (1, arm.joint_count) else slice(None)
        turned = np.exp(1j * (model.angle_of(closed.u, j) - q[:, j - 1]))[poses]
        turned = turned[closed.closed[poses]]
        if len(turned):
            mean = turned.mean()
            spread = np.std(np.angle(turned * mean.conj()))
            offsets[j] = MeasuredOffset(value_rad=float(np.angle(mean)), sigma_rad=float(spread))
    return offsets

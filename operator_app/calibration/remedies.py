"""Offsets of unsensed joints and corrections of RVDTs from a calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from operator_app.calibration.result import Solution
from operator_app.config.parameters import ParametersDocument
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import wrap_angle
from solver.chain.poses import PoseSet
from solver.chain.sensors import NoSensor
from solver.closing import close_loops


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingTable:
    """Corrections of the readings of one joint.

    Attributes
    ----------
    joint
        1-based.
    theta_off_rad
        Offset that belongs to corrected readings.
    gain
        Reading per angle, ideally 1; included in the corrections.
    reading_rad, add_rad, sigma_rad
        (k,): rising readings; corrections to add, linear in between; and their standard uncertainty.
    """

    joint: int
    theta_off_rad: float
    gain: float
    reading_rad: FloatArray
    add_rad: FloatArray
    sigma_rad: FloatArray

    def corrected(self, reading_rad: FloatArray) -> FloatArray:
        """Correct readings; beyond the table its nearest end is used."""
        return np.asarray(reading_rad + np.interp(reading_rad, self.reading_rad, self.add_rad))

    def beyond(self, reading_rad: FloatArray) -> int:
        """Number of readings beyond the table."""
        low, high = self.reading_rad[[0, -1]]
        return int(np.sum((reading_rad < low) | (reading_rad > high)))


def reading_tables(solution: Solution) -> tuple[ReadingTable, ...]:
    """Return the corrections of every RVDT that the poses could determine."""
    found = []
    for verdict in solution.rvdt:
        figures = verdict.figures
        if figures is None or not figures.gain > 0.0:
            continue
        reading, add, sigma = figures.table_rad.T
        # A sensor so bad that its readings run backwards has no table by reading there.
        rising = reading > np.maximum.accumulate(np.concatenate(([-np.inf], reading[:-1])))
        if rising.sum() < 2:
            continue
        found.append(
            ReadingTable(
                joint=verdict.joint,
                theta_off_rad=float(wrap_angle(figures.theta_off_rad)),
                gain=figures.gain,
                reading_rad=reading[rising],
                add_rad=add[rising],
                sigma_rad=sigma[rising],
            )
        )
    return tuple(found)


def tables_of(document: ParametersDocument) -> tuple[ReadingTable, ...]:
    """Return the corrections in a parameters file."""
    found = []
    for remedy in document.rvdt:
        rows = [(row.reading_deg, row.add_deg, row.sigma_deg) for row in remedy.table]
        reading, add, sigma = np.deg2rad(rows).T
        found.append(
            ReadingTable(
                joint=remedy.joint,
                theta_off_rad=math.radians(remedy.theta_off_deg),
                gain=remedy.gain,
                reading_rad=reading,
                add_rad=add,
                sigma_rad=sigma,
            )
        )
    return tuple(found)


def corrected_poses(poses: PoseSet, tables: Sequence[ReadingTable]) -> PoseSet:
    """Return poses with the readings of some joints corrected."""
    q = poses.q_rad.copy()
    for table in tables:
        q[:, table.joint - 1] = table.corrected(q[:, table.joint - 1])
    return replace(poses, q_rad=q)


def measured_offsets(solution: Solution, arm: ArmModel, poses: PoseSet) -> dict[int, float]:
    """Offset (rad) of every joint whose readings were not used, by joint: mean of loop angle minus reading.

    `poses` are those of the solution. A joint without a sensor has no offset.
    """
    model = solution.model
    kept = np.setdiff1d(np.arange(len(poses)), solution.dropped_flipped)
    # The zeros of the first and the last joint are counted from the fixture: several placements, several.
    several = {1, arm.joint_count} if len(poses.placements) > 1 else set()
    joints = [
        j
        for j in model.unsensed_joints
        if not isinstance(arm.joints[j - 1].sensor, NoSensor) and j not in several
    ]
    if not joints or len(kept) != solution.poses:
        return {}
    q = poses.q_rad[kept]
    closed = close_loops(model, solution.estimate.x, q)
    first = closed.u.shape[1] - len(model.unsensed_joints)
    found = {}
    for j in joints:
        angle = closed.u[closed.closed, first + model.unsensed_joints.index(j)]
        turned = np.exp(1j * (angle - q[closed.closed, j - 1]))
        if len(turned):
            found[j] = float(np.angle(turned.mean()))
    return found

"""Poses that a fit excludes (out of range, in radians, flipped), and poses in which a joint moved while it was read."""

from __future__ import annotations

import numpy as np

from operator_app.calibration.findings import sensor_name
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.sensors import Encoder, Rvdt
from solver.diagnostics.limits import MOTION_SPREAD_RAD, MOTION_SPREAD_SIGMAS
from solver.diagnostics.range_checks import RangeFinding, ReadingFault, rows_in_radians


def motion_causes(
    arm: ArmModel, poses: PoseSet, unsensed: tuple[int, ...], labels: tuple[str, ...]
) -> tuple[Finding, ...]:
    """Return the joints whose readings spread within poses by more than their sensor's noise.

    An RVDT that spreads in most poses is noisy, which its own verdict reports. The mean over samples of a moving arm is
    no pose and closes no loop, though the fit may not show it.
    """
    if poses.sd_rad is None:
        return ()
    found = []
    for j, joint in enumerate(arm.joints, 1):
        if not isinstance(joint.sensor, Encoder | Rvdt) or j in unsensed:
            continue
        spread = poses.sd_rad[:, j - 1]
        moved = moved_while_read(joint.sensor, spread)
        there = tuple(int(k) for k in np.argsort(-spread, kind="stable") if moved[k])
        if there:
            found.append(
                Finding(
                    kind=FindingKind.MOTION_DURING_SAMPLING,
                    joint=j,
                    sensor=sensor_name(j, arm),
                    poses=tuple(labels[k] for k in there),
                    size=float(spread[there[0]]),
                    unit="rad",
                )
            )
    return tuple(found)


def moved_while_read(sensor: Encoder | Rvdt, spread_rad: FloatArray) -> BoolArray:
    """Poses (m,) whose readings spread (m,), rad, by more than this sensor's noise.

    The noise is the stated one; for an RVDT, whose noise may be larger, that of most poses.
    """
    noise = sensor.sigma_rad
    if isinstance(sensor, Rvdt):
        noise = max(noise, float(np.median(spread_rad)))
    return np.asarray(spread_rad > max(MOTION_SPREAD_SIGMAS * noise, MOTION_SPREAD_RAD))


MANY = 3
"""This many joints outside their ranges indicate a wrong row; fewer may be the effect of a tool upside down."""


def excluded_poses(
    left_out: tuple[int, ...],
    out_of_range: tuple[RangeFinding, ...],
    arm: ArmModel,
    poses: PoseSet,
) -> tuple[Finding, ...]:
    """Return why each of the poses (indices) was left out; one finding for each reason."""
    joints = {
        k: [f.joint for f in out_of_range if f.fault is ReadingFault.OUTSIDE and k in f.poses]
        for k in left_out
    }
    radians = _in_radians(left_out, arm, poses)
    wrong = tuple(k for k in left_out if len(joints[k]) >= MANY and k not in radians)
    flipped = tuple(k for k in left_out if len(joints[k]) < MANY and k not in radians)
    found = []
    if radians:
        labels = tuple(poses.label[k] for k in sorted(radians))
        found.append(Finding(kind=FindingKind.POSES_IN_RADIANS, poses=labels))
    found.extend(
        Finding(
            kind=FindingKind.POSE_OUT_OF_RANGE, poses=(poses.label[k],), joints=tuple(joints[k])
        )
        for k in wrong
    )
    if flipped:
        found.append(
            Finding(
                kind=FindingKind.POSES_FLIPPED,
                poses=tuple(poses.label[k] for k in flipped),
                figures={"count": len(flipped), "of": len(poses)},
            )
        )
    return tuple(found)


def out_of_range_besides(
    left_out: tuple[int, ...],
    out_of_range: tuple[RangeFinding, ...],
    arm: ArmModel,
    poses: PoseSet,
) -> tuple[RangeFinding, ...]:
    """Joints out of their ranges in poses other than those left out for their unit."""
    radians = _in_radians(left_out, arm, poses)
    return tuple(f for f in out_of_range if not radians.issuperset(f.poses))


def _in_radians(left_out: tuple[int, ...], arm: ArmModel, poses: PoseSet) -> set[int]:
    """Return which of the poses left out are rows in radians."""
    return set(rows_in_radians(arm, poses.q_rad)) & set(left_out) if left_out else set()

"""Where to take poses before the model can be trusted: waypoints of the position-mode joints alone.

A low-discrepancy sequence fills the box that the operator allowed around the start, so that the
first poses already spread and a session that ends early has seen all of it. Nothing here uses the
kinematic model; whether a waypoint can be reached is found out by going there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hardware.arm import ArmSnapshot, Watch
from operator_app.config.procedure import CapturePlan, Exploration
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel

RANGE_MARGIN_RAD = float(np.deg2rad(2.0))
"""A move ends when any joint comes this close to the end of its range."""

DEFAULT_SPAN_DEG = 25.0
"""How far to either side drive joints are taken that the procedure says nothing about."""

BATCH = 8
"""Waypoints are visited in batches of this size, each in a short order: spread first, travel second."""


def waypoints(
    arm: ArmModel, start_rad: FloatArray, plan: CapturePlan
) -> tuple[Mapping[int, float], ...]:
    """Targets of the position-mode joints, in visiting order.

    There are three times as many as poses wanted, so that unreachable ones can be passed over. The
    result depends on the arguments only: a resumed session finds the same plan.
    """
    joints = tuple(box.joint for box in plan.exploration)
    columns = [j - 1 for j in joints]
    start = start_rad[columns]
    low = np.maximum(
        (arm.lower_rad + RANGE_MARGIN_RAD)[columns],
        start + [box.lower_rad for box in plan.exploration],
    )
    high = np.minimum(
        (arm.upper_rad - RANGE_MARGIN_RAD)[columns],
        start + [box.upper_rad for box in plan.exploration],
    )
    unit = _additive_recurrence(3 * plan.poses, len(columns), plan.seed)
    points = low + unit * (high - low)
    order: list[int] = []
    here = start
    for first in range(0, len(points), BATCH):
        left = list(range(first, min(first + BATCH, len(points))))
        while left:
            nearest = min(left, key=lambda k: float(np.abs(points[k] - here).max()))
            left.remove(nearest)
            order.append(nearest)
            here = points[nearest]
    return tuple(
        {joint: float(value) for joint, value in zip(joints, points[k], strict=True)} for k in order
    )


def for_joints(plan: CapturePlan, joints: tuple[int, ...]) -> CapturePlan:
    """Return the plan for these drive joints: the procedure's boxes, a modest one where it has none."""
    known = {box.joint: box for box in plan.exploration}
    if tuple(sorted(known)) == tuple(sorted(joints)):
        return plan
    span = DEFAULT_SPAN_DEG
    return replace(
        plan,
        exploration=tuple(
            known.get(j, Exploration(joint=j, from_deg=-span, to_deg=span)) for j in joints
        ),
    )


def _additive_recurrence(count: int, dimensions: int, seed: int) -> FloatArray:
    """Low-discrepancy points in the unit cube (R-sequence of the generalised golden ratio)."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    shift = np.random.default_rng(seed).random(dimensions)
    return np.asarray((shift + np.outer(np.arange(1, count + 1), steps)) % 1.0)


def overload(arm: ArmModel, snapshot: ArmSnapshot) -> str:
    """Say which joint is near the torque at which its drive trips; empty when none is."""
    for joint, limits in zip(snapshot.joints, arm.joints, strict=True):
        if abs(joint.torque_nm) > 0.8 * limits.max_torque_nm:
            return f"joint {joint.joint} needed {abs(joint.torque_nm):.0f} N m"
    return ""


def range_watch(arm: ArmModel) -> Watch:
    """Watch that ends a move before a joint leaves its range, runs away or is overloaded."""
    lower = arm.lower_rad + RANGE_MARGIN_RAD
    upper = arm.upper_rad - RANGE_MARGIN_RAD

    def watch(snapshot: ArmSnapshot) -> str | None:
        for joint, low, high, limits in zip(snapshot.joints, lower, upper, arm.joints, strict=True):
            outward = (joint.position_rad < low and joint.speed_rad_per_s < 0.0) or (
                joint.position_rad > high and joint.speed_rad_per_s > 0.0
            )
            if outward:
                return f"joint {joint.joint} came close to the end of its range"
            if abs(joint.speed_rad_per_s) > 0.8 * limits.max_speed_rad_per_s:
                degrees = np.rad2deg(abs(joint.speed_rad_per_s))
                return f"joint {joint.joint} ran at {degrees:.0f} deg/s: a fold is near"
        return overload(arm, snapshot) or None

    return watch

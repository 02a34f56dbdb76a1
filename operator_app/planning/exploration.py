"""Where to take poses before the model can be trusted: waypoints of the position-mode joints alone.

A low-discrepancy sequence fills the box that the operator allowed around home, so that the first
poses already spread and a session that ends early has seen all of it. The box is a place, not a
travel: wherever the last session left the arm, the next one moves through the same. Nothing here uses the
kinematic model; whether a waypoint can be reached is found out by going there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Where the drive joints may be taken.

    Attributes
    ----------
    joints
        Drive joints (1-based).
    centre_rad, lower_rad, upper_rad
        (d,) of them, sensor coordinates; the ends keep clear of the joints' ranges.
    """

    joints: tuple[int, ...]
    centre_rad: FloatArray
    lower_rad: FloatArray
    upper_rad: FloatArray

    def beyond_rad(self, positions_rad: FloatArray) -> FloatArray:
        """How far each drive joint (d,) stands outside, positions (n,); 0 inside."""
        here = positions_rad[[j - 1 for j in self.joints]]
        return np.maximum(np.maximum(self.lower_rad - here, here - self.upper_rad), 0.0)


def box_of(
    arm: ArmModel,
    plan: CapturePlan,
    joints: tuple[int, ...],
    *,
    home_rad: FloatArray,
    start_rad: FloatArray,
) -> Box:
    """The procedure's box round `home_rad` (n,) for these drive joints.

    A joint that the procedure says nothing about gets a modest travel round `start_rad` (n,), where
    the session began: it stood there.
    """
    known = {box.joint: box for box in plan.exploration}
    modest = {
        j: Exploration(joint=j, from_deg=-DEFAULT_SPAN_DEG, to_deg=DEFAULT_SPAN_DEG) for j in joints
    }
    if set(joints) == set(known):
        joints = tuple(known)
    boxes = [known.get(j, modest[j]) for j in joints]
    columns = [j - 1 for j in joints]
    centre = np.array([(home_rad if j in known else start_rad)[j - 1] for j in joints])
    return Box(
        joints=joints,
        centre_rad=centre,
        lower_rad=np.maximum(
            (arm.lower_rad + RANGE_MARGIN_RAD)[columns], centre + [box.lower_rad for box in boxes]
        ),
        upper_rad=np.minimum(
            (arm.upper_rad - RANGE_MARGIN_RAD)[columns], centre + [box.upper_rad for box in boxes]
        ),
    )


def waypoints(box: Box, *, poses: int, seed: int) -> tuple[Mapping[int, float], ...]:
    """Targets of the position-mode joints, in visiting order.

    There are three times as many as poses wanted, so that unreachable ones can be passed over. The
    result depends on the arguments only: a resumed session finds the same plan.
    """
    corners = (box.lower_rad, box.upper_rad, box.centre_rad)
    lower, upper, centre = (tuple(map(float, found)) for found in corners)
    return _waypoints(box.joints, lower, upper, centre, poses, seed)


@lru_cache(maxsize=4)
def _waypoints(
    joints: tuple[int, ...],
    lower_rad: tuple[float, ...],
    upper_rad: tuple[float, ...],
    centre_rad: tuple[float, ...],
    poses: int,
    seed: int,
) -> tuple[Mapping[int, float], ...]:
    """Make them once: every visit asks for all of them, and there may be thousands."""
    unit = _additive_recurrence(3 * poses, len(joints), seed)
    low = np.array(lower_rad)
    points = low + unit * (np.array(upper_rad) - low)
    order: list[int] = []
    here = np.array(centre_rad)
    for first in range(0, len(points), BATCH):
        left = list(range(first, min(first + BATCH, len(points))))
        while left:
            nearest = min(left, key=lambda k: float(np.abs(points[k] - here).max()))
            left.remove(nearest)
            order.append(nearest)
            here = points[nearest]
    return tuple(
        MappingProxyType(
            {joint: float(value) for joint, value in zip(joints, points[k], strict=True)}
        )
        for k in order
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


def range_watch(arm: ArmModel, braking_s: float) -> Watch:
    """Watch that ends a move before a joint leaves its range, runs away or is overloaded.

    Free joints may be several times as fast as the drives: what counts is where a joint would come to
    rest if the move braked now, its present speed times `braking_s` ahead
    (`hardware.control.trajectory.coming_to_rest_s`). Where the way was planned, ends and all, that is 0.
    """
    lower = arm.lower_rad + RANGE_MARGIN_RAD
    upper = arm.upper_rad - RANGE_MARGIN_RAD

    def watch(snapshot: ArmSnapshot) -> str | None:
        for joint, low, high, limits in zip(snapshot.joints, lower, upper, arm.joints, strict=True):
            rest = joint.position_rad + joint.speed_rad_per_s * braking_s
            outward = (rest < low and joint.speed_rad_per_s < 0.0) or (
                rest > high and joint.speed_rad_per_s > 0.0
            )
            if outward:
                return f"joint {joint.joint} came close to the end of its range"
            if abs(joint.speed_rad_per_s) > 0.8 * limits.max_speed_rad_per_s:
                degrees = np.rad2deg(abs(joint.speed_rad_per_s))
                return f"joint {joint.joint} ran at {degrees:.0f} deg/s: a fold is near"
        return overload(arm, snapshot) or None

    return watch

"""Waypoints of the drive joints for captures without a kinematic model, and callbacks that end a move.

A low-discrepancy sequence fills the procedure's box (ranges of drive angles around home), so that even a short session
covers the whole box. Only the move itself shows whether a waypoint can be reached.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from hardware.arm import ArmSnapshot, Watch
from operator_app.config.procedure import CapturePlan, Exploration
from solver.arrays import FloatArray, even_points
from solver.chain.arm_model import ArmModel

RANGE_END_MARGIN_RAD = float(np.deg2rad(2.0))
"""Margin to both ends of a joint's range: a move ends before a joint comes closer than this."""

DEFAULT_SPAN_DEG = 25.0
"""Half width of the box in each drive joint for which the procedure states no range."""

BATCH = 8
"""Waypoints are sorted for short moves within batches of this size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Ranges of the drive joints' angles within which poses are explored.

    `joints`: drive joints (1-based). `centre_rad`, `lower_rad`, `upper_rad` (d,): centre and limits of the box, sensor
    coordinates; the limits are inside the joint ranges.
    """

    joints: tuple[int, ...]
    centre_rad: tuple[float, ...]
    lower_rad: tuple[float, ...]
    upper_rad: tuple[float, ...]

    def beyond_rad(self, positions_rad: FloatArray) -> FloatArray:
        """Return how far (d,), rad, each drive joint is outside the box at `positions_rad` (n,); 0 inside."""
        positions = positions_rad[[j - 1 for j in self.joints]]
        # If a joint starts beyond the end of its range, the box may be empty; then every position is outside it.
        below, above = np.subtract(self.lower_rad, positions), positions - self.upper_rad
        return np.maximum(np.maximum(below, above), 0.0)


def box_of(
    arm: ArmModel,
    plan: CapturePlan,
    joints: tuple[int, ...],
    *,
    home_rad: FloatArray,
    start_rad: FloatArray,
) -> Box:
    """Return the box of the drive joints `joints`: the ranges around `home_rad` (n,) that the procedure states.

    A joint without a stated range gets `DEFAULT_SPAN_DEG` on each side of its start angle in `start_rad` (n,).
    """
    known = {box.joint: box for box in plan.exploration}
    if set(joints) == set(known):
        joints = tuple(known)
    centres, lower, upper = [], [], []
    for j in joints:
        modest = Exploration(joint=j, from_deg=-DEFAULT_SPAN_DEG, to_deg=DEFAULT_SPAN_DEG)
        box, limits = known.get(j, modest), arm.joints[j - 1]
        centre = float((home_rad if j in known else start_rad)[j - 1])
        centres.append(centre)
        lower.append(max(limits.lower_rad + RANGE_END_MARGIN_RAD, centre + box.lower_rad))
        upper.append(min(limits.upper_rad - RANGE_END_MARGIN_RAD, centre + box.upper_rad))
    return Box(
        joints=joints, centre_rad=tuple(centres), lower_rad=tuple(lower), upper_rad=tuple(upper)
    )


@lru_cache(maxsize=4)
def waypoints(box: Box, *, poses: int, seed: int) -> tuple[Mapping[int, float], ...]:
    """Return the targets (joint number: rad) of the drive joints, in visiting order.

    There are three targets per requested pose, as some may be unreachable. The same arguments give the same targets,
    so that a resumed session continues its plan. The result is cached, because it is needed again for every waypoint.
    """
    low, high = np.array(box.lower_rad), np.array(box.upper_rad)
    start = np.random.default_rng(seed).random(len(low))
    points = low + even_points(3 * poses, len(low), start) * (high - low)
    order: list[int] = []
    current = np.array(box.centre_rad)
    for first in range(0, len(points), BATCH):
        remaining = list(range(first, min(first + BATCH, len(points))))
        while remaining:
            nearest = min(remaining, key=lambda k: float(np.abs(points[k] - current).max()))
            remaining.remove(nearest)
            order.append(nearest)
            current = points[nearest]
    return tuple(
        MappingProxyType(dict(zip(box.joints, points[k].tolist(), strict=True))) for k in order
    )


def overload(arm: ArmModel, snapshot: ArmSnapshot) -> str:
    """Return text that names a joint above 80 % of its largest torque; "" if there is none."""
    for joint, limits in zip(snapshot.joints, arm.joints, strict=True):
        if abs(joint.torque_nm) > 0.8 * limits.max_torque_nm:
            return f"joint {joint.joint} needed {abs(joint.torque_nm):.0f} N m"
    return ""


def range_watch(arm: ArmModel, braking_s: float) -> Watch:
    """Return a callback that ends a move if a joint is too fast, is overloaded, or is about to leave its range.

    Free joints may be faster than the drives. Therefore the range is checked where a joint would come to rest: its
    position plus its speed times `braking_s`. For planned paths, `braking_s` is 0.
    """
    lower = arm.lower_rad + RANGE_END_MARGIN_RAD
    upper = arm.upper_rad - RANGE_END_MARGIN_RAD

    def watch(snapshot: ArmSnapshot) -> str | None:
        for joint, low, high, limits in zip(snapshot.joints, lower, upper, arm.joints, strict=True):
            speed = joint.speed_rad_per_s
            rest = joint.position_rad + speed * braking_s
            if (rest < low and speed < 0.0) or (rest > high and speed > 0.0):
                return f"joint {joint.joint} came close to the end of its range"
            if abs(speed) > 0.8 * limits.max_speed_rad_per_s:
                degrees = np.rad2deg(abs(speed))
                return f"joint {joint.joint} moved at {degrees:.0f} deg/s: a singularity is near"
        return overload(arm, snapshot) or None

    return watch

"""Converts axes and poses of a URDF to D-H rows, with Hayati's beta for parallel axes."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from operator_app.config.arm_file import PARALLEL_RAD
from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable, forward

MEET_M = 1e-9
"""Distance below which axes count as intersecting."""
MEETING_SINE, FAR_M = 1e-9, 2.0
"""If the tip's z axis is nearly parallel to the last joint's axis, the last row follows their common normal only if the
sine of the angle between them exceeds MEETING_SINE, and the row's s and a are below FAR_M."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisLine:
    """A joint axis in the base link's frame, all joints at zero: direction, point and preferred x axis, each (3,)."""

    z: FloatArray
    point_m: FloatArray
    x: FloatArray


def rows_of(
    axes: Sequence[AxisLine], T_base_tip: FloatArray
) -> tuple[DhTable, tuple[FloatArray, ...]]:
    """Return the D-H rows 1..n and the frames 0..n of the chain with the joint axes `axes` and the tip `T_base_tip`.

    All poses are (4, 4), m, in the base link's frame with all joints at zero. Frame 0 is on axis 1 near the base
    link's origin; frame n is as near to the tip as a D-H row allows.
    """
    z = axes[0].z
    # Frame 0 equals the base link's frame if axis 1 is its z axis.
    origin = axes[0].point_m - float(axes[0].point_m @ z) * z
    x = _across(z)
    frame_0 = np.eye(4)
    frame_0[:3, :3], frame_0[:3, 3] = np.column_stack((x, np.cross(z, x), z)), origin
    frames, rows = [frame_0], list[tuple[float, ...]]()
    tip = AxisLine(z=T_base_tip[:3, 2], point_m=T_base_tip[:3, 3], x=T_base_tip[:3, 0])
    for line in (*axes[1:], tip):
        sine = float(np.linalg.norm(np.cross(z, line.z)))
        if sine > math.sin(PARALLEL_RAD):
            row = _by_common_normal(frames[-1], line)
        elif line is not tip:
            row = _hayati(frames[-1], line)
        else:
            row = _to_tip(frames[-1], tip, sine)
        rows.append(row)
        frames.append(frames[-1] @ link_transform(row))
        z = frames[-1][:3, 2]
    columns = np.array(rows).T
    # Sines and cosines have rounding errors.
    return DhTable.from_stacked(np.where(np.abs(columns) < 1e-12, 0.0, columns)), tuple(frames)


def link_transform(row: Sequence[float]) -> FloatArray:
    """Return ``Rz(theta_off) Tz(s) Tx(a) Rx(alpha) Ry(beta)``, (4, 4), m; `row`: theta_off, s, a, alpha, beta."""
    link, T = forward(*np.reshape(row, (5, 1))), np.eye(4)
    T[:3, :3], T[:3, 3] = link.R_end, link.p_end
    return T


def _by_common_normal(before: FloatArray, line: AxisLine) -> tuple[float, ...]:
    """Return the D-H row along the common normal from frame `before` to the axis `line`, which is not parallel to z."""
    x, z, origin = before[:3, 0], before[:3, 2], before[:3, 3]
    normal = np.cross(z, line.z)
    normal /= np.linalg.norm(normal)
    # origin + s z + a normal = point + u next_z
    s, a, _ = np.linalg.solve(np.column_stack((z, normal, -line.z)), line.point_m - origin)
    if normal @ line.x < 0.0:
        normal, a = -normal, -a
    return (_angle(x, normal, z), float(s), float(a), _angle(z, line.z, normal), 0.0)


def _hayati(before: FloatArray, line: AxisLine) -> tuple[float, ...]:
    """Return the row with Hayati's beta from frame `before` to the axis `line`, which is nearly parallel to z.

    The origin of the next frame is where `line` crosses the x-y plane of frame `before` (the paper's reference [9]).
    """
    x, z, origin = before[:3, 0], before[:3, 2], before[:3, 3]
    apart = line.point_m - origin
    apart = apart - (apart @ z) / (line.z @ z) * line.z
    normal, a = _normal_to(line, apart, z)
    # Rx(alpha) Ry(beta) takes z to (sin beta, -sin alpha cos beta, cos alpha cos beta).
    alpha = math.atan2(-float(line.z @ np.cross(z, normal)), float(line.z @ z))
    beta = math.asin(min(1.0, max(-1.0, float(line.z @ normal))))
    return (_angle(x, normal, z), 0.0, a, alpha, beta)


def _to_tip(before: FloatArray, tip: AxisLine, sine: float) -> tuple[float, ...]:
    """Return the last D-H row, from frame `before` to a tip whose z axis is nearly parallel to the last joint's axis.

    `sine`: sine of the angle between the two axes. The row follows their common normal if s and a are then less than
    `FAR_M`. Otherwise, and for exactly parallel axes, the row leads to the tip's origin and neglects the angle.
    """
    if sine > MEETING_SINE:
        row = _by_common_normal(before, tip)
        if max(abs(row[1]), abs(row[2])) < FAR_M:
            return row
    x, z, origin = before[:3, 0], before[:3, 2], before[:3, 3]
    apart = tip.point_m - origin
    s = float(apart @ z)
    normal, a = _normal_to(tip, apart - s * z, z)
    return (_angle(x, normal, z), s, a, 0.0 if tip.z @ z > 0.0 else math.pi, 0.0)


def _normal_to(line: AxisLine, apart: FloatArray, z: FloatArray) -> tuple[FloatArray, float]:
    """Return the x axis (3,) of the next frame, along `apart`, and the signed distance to `line` along this axis, m.

    `apart` (3,): vector from the axis `z` to `line`, perpendicular to `z`, m. The x axis is the direction of `apart` or
    its opposite, within 90 deg of `line.x`. If `apart` is zero, x is `line.x` made perpendicular to `z`, and the
    distance is 0.
    """
    a = float(np.linalg.norm(apart))
    if a <= MEET_M:
        return _across(z, line.x), 0.0
    normal = apart / a
    return (-normal, -a) if normal @ line.x < 0.0 else (normal, a)


def _across(z: FloatArray, *preferred: FloatArray) -> FloatArray:
    """Return a unit vector normal to `z`, projected from `preferred` vectors, or from x or y if those are along `z`."""
    across = (d - (d @ z) * z for d in (*preferred, *np.eye(3)[:2]))
    return next(x / np.linalg.norm(x) for x in across if np.linalg.norm(x) > 0.1)


def _angle(a: FloatArray, b: FloatArray, about: FloatArray) -> float:
    return float(np.arctan2(np.cross(a, b) @ about, a @ b))


EXACT_PLACES = 13
"""An angle with at least this many decimal places counts as not rounded."""


def rotation_of_rpy(rpy: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of roll, pitch, yaw (3,), rad: ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    roll, pitch, yaw = rpy
    # One link turns about z and y, another about x.
    zero = np.zeros(2)
    theta, alpha, beta = np.array([[yaw, 0.0], [0.0, roll], [pitch, 0.0]])
    return forward(theta, zero, zero, alpha, beta).R_end


def rpy_of(R: FloatArray) -> FloatArray:
    """Return roll, pitch, yaw (3,), rad, of a rotation matrix; also exact at a pitch of 90 deg."""
    yaw = math.atan2(R[1, 0], R[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return np.array([roll, pitch, yaw])


def origin_words(T: FloatArray) -> dict[str, str]:
    """Return the attributes ``xyz`` and ``rpy`` of a URDF's ``<origin>`` for the pose `T` (4, 4), m."""
    # Rounding errors of sines, and -0.0, are written as 0.
    numbers = {"xyz": T[:3, 3], "rpy": rpy_of(T[:3, :3])}
    return {
        key: " ".join(repr(float(v)) if abs(v) > 1e-16 else "0" for v in values)
        for key, values in numbers.items()
    }


def exact_deg(word: str) -> float | None:
    """Return the exact angle, deg, that the text `word`, in rad, states rounded or truncated; None if there is none.

    With four or more decimals (1.5708, 0.7854), the angle is a multiple of 15 deg, with two or three (3.14) of 90 deg.
    """
    match = re.fullmatch(r"[+-]?\d+\.(\d+)", word)
    if match is None or not 2 <= len(match[1]) < EXACT_PLACES:
        return None
    places, value = len(match[1]), float(word)
    step = 15.0 if places >= 4 else 90.0
    deg = step * round(math.degrees(value) / step)
    meant, unit = abs(math.radians(deg)), 10.0**places
    near = (math.floor(meant * unit) / unit, round(meant, places))
    return deg if deg and any(abs(abs(value) - v) < 1e-3 / unit for v in near) else None

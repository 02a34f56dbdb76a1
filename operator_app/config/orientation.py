"""How a measured target is turned, by the names of its columns, as a rotation vector.

There is no default: a rotation vector and three Euler angles look alike, and mean something else.

====================================  ==============================================================
``rx_deg, ry_deg, rz_deg``            a rotation vector: axis times angle
``roll_deg, pitch_deg, yaw_deg``      about the fixed axes x, y, z in turn: ``Rz(yaw) Ry(pitch) Rx(roll)``
``euler_zyx_1_deg, .._2_.., .._3_..``  about the moving axes z, y', x'': ``Rz(1) Ry(2) Rx(3)`` (KUKA's A, B,
                                      C); any of the twelve orders, such as ``euler_zyz_1_deg``
``qw, qx, qy, qz``                    a unit quaternion
====================================  ==============================================================
"""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np

from solver.arrays import FloatArray
from solver.chain.rotations import rotation_vector

ROTATION = ("rx_deg", "ry_deg", "rz_deg")
ROLL_PITCH_YAW = ("roll_deg", "pitch_deg", "yaw_deg")
QUATERNION = ("qw", "qx", "qy", "qz")
EULER = re.compile(r"euler_([xyz]{3})_[123]_deg")
EXAMPLE = (
    "rx_deg,ry_deg,rz_deg (rotation vector), roll_deg,pitch_deg,yaw_deg, "
    "euler_zyx_1_deg,euler_zyx_2_deg,euler_zyx_3_deg or qw,qx,qy,qz"
)

UNIT_WITHIN = 1e-3
"""A quaternion written with few digits is this far from unit length, not more."""


def group_of(name: str) -> tuple[str, ...] | None:
    """Columns that a column of this name belongs to, in order; None: it says nothing of a turn."""
    for group in (ROTATION, ROLL_PITCH_YAW, QUATERNION):
        if name in group:
            return group
    match = EULER.fullmatch(name)
    if match is None or any(a == b for a, b in zip(match[1], match[1][1:], strict=False)):
        return None
    return tuple(f"euler_{match[1]}_{k}_deg" for k in (1, 2, 3))


def groups_in(names: Collection[str]) -> tuple[tuple[str, ...], ...]:
    """All ways of writing a turn that any of these names belongs to; one, or none, is in order."""
    found = {group: None for name in names if (group := group_of(name)) is not None}
    return tuple(found)


def rotation_vectors(group: tuple[str, ...], values: FloatArray) -> FloatArray:
    """Rotation vectors (m, 3), rad, of the values (m, 3 or 4) of these columns, deg or a quaternion.

    Raises
    ------
    ValueError
        A quaternion is none; says how long it is.
    """
    if group == ROTATION:
        return np.deg2rad(values)
    if group == QUATERNION:
        return _of_quaternions(values)
    if group == ROLL_PITCH_YAW:
        return _of_turns("zyx", np.deg2rad(values[:, ::-1]))
    match = EULER.fullmatch(group[0])
    if match is None:
        raise ValueError(f"{group[0]} says nothing of a turn")
    return _of_turns(match[1], np.deg2rad(values))


def _of_turns(axes: str, angles: FloatArray) -> FloatArray:
    """Turns by `angles` (m, 3) about the moving `axes` one after the other."""
    R = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    for axis, angle in zip(axes, angles.T, strict=True):
        R = R @ _about(axis, angle)
    return rotation_vector(R)


def _about(axis: str, angle: FloatArray) -> FloatArray:
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    R = np.zeros((len(angle), 3, 3))
    R[:, k, k] = 1.0
    R[:, i, i] = R[:, j, j] = np.cos(angle)
    R[:, j, i] = np.sin(angle)
    R[:, i, j] = -R[:, j, i]
    return R


def _of_quaternions(q: FloatArray) -> FloatArray:
    length = np.linalg.norm(q, axis=1, keepdims=True)
    if np.any(np.abs(length - 1.0) > UNIT_WITHIN):
        worst = float(length[np.argmax(np.abs(length - 1.0))].item())
        raise ValueError(f"a quaternion of length {worst:.4g}: one that is a turn has length 1")
    q = q / length
    # Both signs are the same turn: the one of at most half a turn is the shorter way.
    q = np.where(q[:, :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[:, :1])
    scale = np.where(sine < 1e-12, 2.0, angle / np.maximum(sine, 1e-300))
    return np.asarray(q[:, 1:] * scale)

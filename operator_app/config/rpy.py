"""Places as a URDF writes them: xyz, and rpy about fixed axes, ``Rz(yaw) Ry(pitch) Rx(roll)``."""

from __future__ import annotations

import math
import re

import numpy as np

from solver.arrays import FloatArray

EXACT_PLACES = 13
"""Decimals of an angle that is rounded no more than a double is."""


def rotation_of_rpy(rpy: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of roll, pitch, yaw, rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_of(R: FloatArray) -> FloatArray:
    """Roll, pitch, yaw (3,), rad, of a rotation matrix; to the last digits at a pitch of 90 deg too."""
    yaw = math.atan2(R[1, 0], R[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return np.array([roll, pitch, yaw])


def origin_words(T: FloatArray) -> dict[str, str]:
    """Attributes of an <origin> at a place (4, 4), m."""
    # -0.0 and the rounding of sines are no figures.
    numbers = {"xyz": T[:3, 3], "rpy": rpy_of(T[:3, :3])}
    return {
        key: " ".join(repr(float(v)) if abs(v) > 1e-16 else "0" for v in values)
        for key, values in numbers.items()
    }


def meant_deg(word: str) -> float | None:
    """Angle in deg of which a word is the rounded or cut-off value in rad; None where it is as it stands.

    Four decimals or more stand for a multiple of 15 deg (1.5708, 0.7854), two or three of 90 deg (3.14).
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

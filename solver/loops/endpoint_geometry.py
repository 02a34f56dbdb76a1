"""Converts the geometry of a fixture into the D-H entries of a loop.

A hinge makes a line of the tool coincide with a line of the table (the workbench). The table's line is given in the
arm's base frame, turned about and shifted along z_0 so that theta_off_1 and s_1 are zero. The tool's line is given in
the frame before the last link. The common normal of the table's line and z_0, and that of the tool's line and z_{n-1},
determine the D-H entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import wrap_angle
from solver.chain.rotations import rotation_about_x, rotation_about_z


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A line in space: a point on it (3,), m, and its direction, a unit vector (3,)."""

    point_m: FloatArray
    direction: FloatArray

    def in_frame(self, R: FloatArray, p_m: FloatArray) -> Line:
        """Return the line in another frame, in which the present frame has the rotation `R` and the origin `p_m`."""
        return Line(point_m=p_m + R @ self.point_m, direction=R @ self.direction)


def constrained_axis_entries(ground: Line, hand: Line, n: int) -> dict[str, float]:
    """Return the D-H entries of links 0, 1 and n, by name, that make two lines coincide; alphas are in [0, pi].

    If a line is parallel to the neighbouring joint axis, the common normal through `point_m` of the line is used.
    `ground`: the line of the table, in the base frame turned and shifted so that theta_off_1 and s_1 are zero.
    `hand`: the line of the tool, in frame n-1 rotated about its z axis by the reading theta_n of joint n (without the
    offset theta_off_n).
    """
    # Tool: direction = Rz(off_n) (0, -sin alpha_n, cos alpha_n).
    off_n = _bearing(hand.direction) + 0.5 * np.pi
    alpha_n = _tilt(hand.direction)
    t = rotation_about_z(-off_n) @ hand.point_m
    # Distance of the tool point along the line from the foot of the common normal with z_{n-1}.
    slide = -_quotient(t[1], np.sin(alpha_n))
    # Table: Rz(off_1) direction = (0, sin alpha_0, cos alpha_0), z_-1 seen in frame 0.
    off_1 = 0.5 * np.pi - _bearing(ground.direction)
    alpha_0 = _tilt(ground.direction)
    g = rotation_about_z(off_1) @ (ground.point_m - slide * ground.direction)
    s_0 = -_quotient(g[1], np.sin(alpha_0))
    return {
        "theta_off_1": float(wrap_angle(off_1)),
        "s_0": s_0,
        "a_0": float(-g[0]),
        "alpha_0": alpha_0,
        "s_1": float(-s_0 * np.cos(alpha_0) - g[2]),
        f"theta_off_{n}": float(wrap_angle(off_n)),
        f"s_{n}": float(t[2] - slide * np.cos(alpha_n)),
        f"a_{n}": float(t[0]),
        f"alpha_{n}": alpha_n,
    }


def constrained_frame_entries(R: FloatArray, p_m: FloatArray, n: int) -> dict[str, float]:
    """Return the D-H entries of links 0, 1 and n, by name, of a rigid loop with s_n = a_n = alpha_n = 0.

    `R` (3, 3), `p_m` (3,): rotation and origin, the same at all poses, of frame n, calculated with theta_off_n = 0,
    in the base frame turned and shifted so that theta_off_1 and s_1 are zero.
    """
    hand = Line(point_m=np.zeros(3), direction=np.array([0.0, 0.0, 1.0]))
    entries = constrained_axis_entries(Line(point_m=p_m, direction=R[:, 2]), hand, n)
    # R Rz(off_n) is Rz(-off_1) Rx(-alpha_0).
    turn = rotation_about_x(entries["alpha_0"]) @ rotation_about_z(entries["theta_off_1"]) @ R
    ground_entries = {
        name: entries[name] for name in ("theta_off_1", "s_0", "a_0", "alpha_0", "s_1")
    }
    return ground_entries | {f"theta_off_{n}": float(-np.arctan2(turn[1, 0], turn[0, 0]))}


def _bearing(v: FloatArray) -> float:
    return float(np.arctan2(v[1], v[0]))


def _tilt(v: FloatArray) -> float:
    return float(np.arctan2(np.hypot(v[0], v[1]), v[2]))


def _quotient(numerator: float, sine: float) -> float:
    return float(numerator / sine) if abs(sine) > 1e-9 else 0.0

"""Fixtures from measurements: a hinge from two lines, a ball from two points.

Measured in frame 0 and the last frame of the arm's D-H table. Without a measurement in the base, the fixture is
placed where the tool has it with the arm at home.
"""

from __future__ import annotations

import numpy as np

from fixtures.ball import Ball
from fixtures.base import Fixture
from fixtures.hinge import Hinge
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import forward
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.loops.endpoint_geometry import Line


def ball_between(arm: ArmModel, hand_m: FloatArray, base_m: FloatArray | None) -> Ball:
    """Return the ball with its centre at `hand_m` (3,) in the tool frame and its socket at `base_m` (3,)."""
    if base_m is None:
        R, p = _hand_at_home(arm)
        base_m = p + R @ hand_m
    x, y, z = hand_m.tolist()
    u, v, w = base_m.tolist()
    return Ball(tip_m=(x, y, z), ground_m=(u, v, w))


def hinge_between(arm: ArmModel, hand: Line, base: Line | None) -> Hinge:
    """Return the hinge between a line in the tool frame and one in the base; their points coincide.

    Of the two directions along the base's line, the one that closes nearer to the arm's home.
    """
    if base is None:
        R, p = _hand_at_home(arm)
        return Hinge.between(
            arm, Line(point_m=p + R @ hand.point_m, direction=R @ hand.direction), hand
        )
    ways = [
        Hinge.between(arm, Line(point_m=base.point_m, direction=sign * base.direction), hand)
        for sign in (1.0, -1.0)
    ]
    return min(ways, key=lambda hinge: _distance(arm, hinge))


def from_home_rad(arm: ArmModel, fixture: Fixture) -> FloatArray | None:
    """Return the distance (n,) of the closed pose nearest to the arm's home; None if none closes."""
    model = fixture.model(arm)
    home = close_loops(model, nominal_vector(model.parameters), arm.home_rad[None])
    return home.q[0] - arm.home_rad if home.closed[0] else None


def _distance(arm: ArmModel, fixture: Fixture) -> float:
    off = from_home_rad(arm, fixture)
    return np.inf if off is None else float(np.abs(off).max())


def _hand_at_home(arm: ArmModel) -> tuple[FloatArray, FloatArray]:
    theta_off, *lengths_and_twists = arm.table.stacked()
    frames = forward(arm.home_rad + theta_off, *lengths_and_twists)
    return frames.R_end, frames.p_end

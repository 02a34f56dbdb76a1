"""Fixtures from what was measured of them: a hinge from two lines, a ball from two points. Knows no file.

Measured in frame 0 of the arm's D-H table and in its last frame. Where the base's side was not measured,
it is where the hand has it when the arm stands at its home.
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
    """Return the ball whose centre is at `hand_m` (3,) in the hand and whose socket at `base_m` (3,)."""
    if base_m is None:
        R, p = _hand_at_home(arm)
        base_m = p + R @ hand_m
    x, y, z = hand_m.tolist()
    u, v, w = base_m.tolist()
    return Ball(tip_m=(x, y, z), ground_m=(u, v, w))


def hinge_between(arm: ArmModel, hand: Line, base: Line | None) -> Hinge:
    """Return the hinge between a line in the hand and one in the base.

    A hinge does not slide: their points are one and the same.

    Nobody can tell which way along the base's line is that along the hand's: of both, the way that
    closes nearer to the arm's home.
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
    """How far (n,) the closed pose nearest to the arm's home is from it; None where none closes."""
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

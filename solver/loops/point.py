"""A point of the tool constrained to a point of the table: the loop of a ball joint.

``p_n(q) + R_n(q) b - g = 0`` in the arm's base frame: b is the ball's centre in the flange frame n
(tip_x, tip_y, tip_z), g the socket's centre in the base frame (ground_x, ground_y, ground_z). The ball's own three
rotations are eliminated by leaving out the orientation: three equations for each pose [3], [5].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from solver.arrays import FloatArray
from solver.loops.arm_loop import ArmLoop
from solver.loops.closure import ConstrainedPart, LoopError
from solver.loops.endpoint_geometry import Line

TIP = ("tip_x", "tip_y", "tip_z")
GROUND = ("ground_x", "ground_y", "ground_z")


@dataclass(frozen=True, slots=True, kw_only=True)
class PointClosure(ArmLoop):
    """An arm of links 1..n with a ball on the tool, in a socket on the table.

    `tip_m`, `ground_m`: nominal centre of the ball in the flange frame, and of the socket in the base frame, (3,).
    `own`: unknowns among tip_x .. ground_z. theta_off_1 and s_1 are the same in all placements, but they cannot be
    separated from a rotation or a lift of all sockets, however many there are.
    """

    OWN: ClassVar[tuple[str, ...]] = TIP + GROUND
    GROUND_SIDE: ClassVar[tuple[str, ...]] = GROUND
    ARRAYS: ClassVar[tuple[str, ...]] = ("tip_m", "ground_m")
    components: ClassVar[int] = 3
    constrained_part: ClassVar[ConstrainedPart] = ConstrainedPart.POINT

    tip_m: FloatArray
    ground_m: FloatArray
    own: tuple[str, ...] = TIP + GROUND

    def _own_nominal(self) -> FloatArray:
        return np.concatenate((self.tip_m, self.ground_m))

    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Vector from the socket's centre to the ball's (m), in the base frame, and its exact derivatives."""
        own = self.own_values(x)
        frames = self.frames(x, q, u)
        lever = (frames.R_end @ own[..., :3, None])[..., 0]
        ground = np.broadcast_to(-np.eye(3), frames.R_end.shape)
        return self.loop_error(
            frames.p_end + lever - own[..., 3:],
            self.columns(frames, lever)[..., 3:, :],
            np.concatenate((frames.R_end, ground), axis=-1),
        )

    def fixture_axes(
        self, x: FloatArray, q: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Axes (m, 3, 3) of the socket, fixed in the base frame, and of the ball, which turns with the tool."""
        table, _ = ArmLoop.fixture_axes(self, x, q, u)
        return table, self.frames(x, q, u).R_end

    def constraint_entries(
        self, ground: Line, hand: Line, rotation: FloatArray
    ) -> dict[str, float]:
        """Centres of ball and socket by name, m: the points of `hand` and `ground`, with nominal rows n and 1."""
        table = self.table
        # Links n and 1 have their nominal values.
        c, s = np.cos(table.theta_off_rad), np.sin(table.theta_off_rad)
        ca, sa = np.cos(table.alpha_rad[-1]), np.sin(table.alpha_rad[-1])
        x, y, z = hand.point_m
        along, across, up = (
            c[-1] * x + s[-1] * y - table.a_m[-1],
            c[-1] * y - s[-1] * x,
            z - table.s_m[-1],
        )
        tip = (along, ca * across + sa * up, ca * up - sa * across)
        x, y, z = ground.point_m
        socket = (c[0] * x - s[0] * y, s[0] * x + c[0] * y, z + table.s_m[0])
        return dict(zip(TIP + GROUND, map(float, (*tip, *socket)), strict=True))

    def fixture_axis(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centre of the socket, m, and a zero axis."""
        return self.own_values(x)[0, 3:], np.zeros(3)

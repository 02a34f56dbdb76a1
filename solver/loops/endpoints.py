"""Loops of an arm whose endpoint has unknowns of its own: a ball in a socket, or a target that an instrument measures.

A ball joint constrains a point of the tool to a point of the table: ``p_n(q) + R_n(q) b - g = 0`` in the arm's base
frame, with b the ball's centre in the flange frame n (tip_x, tip_y, tip_z), g the socket's centre in the base frame
(ground_x, ground_y, ground_z). The ball's own three rotations are eliminated by leaving out the orientation: three
equations for each pose [3], [5].

An instrument that measures the endpoint of the open arm closes the loop of each pose: ``T_instrument_base T_base_n(q)
T_n_tip = measured`` (paper, section 2.1, eqs. 4 to 7), in the instrument's frame. The noise of the instrument takes the
place of the fixture's deflection (`NoiseModel.fixture_variance`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from solver.arrays import FloatArray, IntArray, select_poses
from solver.chain.rotations import (
    rotation_about_x,
    rotation_about_z,
    rotation_matrix,
    rotation_vector,
    rotation_vector_differential,
)
from solver.loops.arm_loop import ArmLoop
from solver.loops.closure import ConstrainedPart, LoopError
from solver.loops.endpoint_geometry import Line

TIP = ("tip_x", "tip_y", "tip_z")
GROUND = ("ground_x", "ground_y", "ground_z")


@dataclass(frozen=True, slots=True, kw_only=True)
class PointClosure(ArmLoop):
    """An arm of links 1..n with a ball on the tool, in a socket on the table.

    `tip_m`, `ground_m`: nominal centre of the ball in the flange frame, and of the socket in the base frame, (3,).
    `own`: names of the unknowns among tip_x .. ground_z.
    No number of sockets determines theta_off_1 and s_1: their errors look like a rotation or a lift of all sockets.
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
        """Return axes (m, 3, 3) in the base frame: the socket's (identity) and the ball's, which turn with the tool."""
        table, _ = ArmLoop.fixture_axes(self, x, q, u)
        return table, self.frames(x, q, u).R_end

    def constraint_entries(
        self, ground: Line, hand: Line, rotation: FloatArray
    ) -> dict[str, float]:
        """Return tip_x .. ground_z, m, from the points of `hand` and `ground` and the nominal D-H rows 1 and n."""
        off, s, a, alpha, _ = self.table.stacked()
        across = rotation_about_z(-off[-1]) @ hand.point_m - [a[-1], 0.0, s[-1]]
        tip = rotation_about_x(-alpha[-1]) @ across
        socket = rotation_about_z(off[0]) @ ground.point_m + [0.0, 0.0, s[0]]
        return dict(zip(TIP + GROUND, [*tip.tolist(), *socket.tolist()], strict=True))

    def fixture_axis(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centre of the socket, m, and a zero axis."""
        return self.own_values(x)[0, 3:], np.zeros(3)


BASE = ("base_x", "base_y", "base_z", "base_rx", "base_ry", "base_rz")
TIP_TURN = ("tip_rx", "tip_ry", "tip_rz")


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredClosure(ArmLoop):
    """An arm of links 1..n that carries a target measured by an instrument.

    base_x .. base_rz place the arm's base frame in the instrument's frame, and tip_x .. tip_rz place the target in the
    flange frame: x, y, z are a position, and rx, ry, rz a rotation vector r with ``R = exp(r) R_nominal``. Because r is
    relative to the nominal rotation, its components are small angles.

    `own`: names of the unknowns among base_x .. tip_rz. Measured positions alone do not determine tip_rx .. tip_rz.
    `base_m`, `base_rotation`, `tip_m`, `tip_rotation`: nominal placements, positions (3,) and rotations (3, 3).
    `full_pose`: whether the orientation of the target is measured, too.
    `endpoint_m`, `endpoint_rotation`: measured positions (m, 3) and, for full poses, orientations (m, 3, 3) of the
    target in the instrument's frame; None before a call of `with_endpoints`.
    """

    OWN: ClassVar[tuple[str, ...]] = BASE + TIP + TIP_TURN
    OWN_ANGLES: ClassVar[tuple[str, ...]] = BASE[3:] + TIP_TURN
    GROUND_SIDE: ClassVar[tuple[str, ...]] = BASE
    ARRAYS: ClassVar[tuple[str, ...]] = (
        "base_m", "base_rotation", "tip_m", "tip_rotation", "endpoint_m", "endpoint_rotation",
    )  # fmt: skip

    base_m: FloatArray
    base_rotation: FloatArray
    tip_m: FloatArray
    tip_rotation: FloatArray
    full_pose: bool
    endpoint_m: FloatArray | None = None
    endpoint_rotation: FloatArray | None = None

    def _own_nominal(self) -> FloatArray:
        return np.concatenate((self.base_m, np.zeros(3), self.tip_m, np.zeros(3)))

    @property
    def components(self) -> int:
        """Number of closure components: 6 (rotation and position) or 3 (position only)."""
        return 6 if self.full_pose else 3

    def with_endpoints(
        self, position_m: FloatArray, rotation: FloatArray | None = None
    ) -> MeasuredClosure:
        """Return the model with measured positions (m, 3) and, for full poses, orientations (m, 3, 3) of m poses."""
        if self.full_pose != (rotation is not None):
            requirement = "needs" if self.full_pose else "does not use"
            raise ValueError(f"this measurement {requirement} orientations")
        return replace(self, endpoint_m=position_m, endpoint_rotation=rotation)

    def predicted(self, x: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position (..., m, 3), m, and orientation (..., m, 3, 3) of the target in the instrument's frame."""
        own = self.own_values(x)
        frames = self.frames(x, q, self.initial_unsensed(x, q))
        R_base = rotation_matrix(own[..., 3:6]) @ self.base_rotation
        tip = frames.p_end + (frames.R_end @ own[..., 6:9, None])[..., 0]
        R_tip = R_base @ frames.R_end @ rotation_matrix(own[..., 9:12]) @ self.tip_rotation
        return own[..., :3] + (R_base @ tip[..., None])[..., 0], R_tip

    def placements(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return T_instrument_base and T_flange_target, (4, 4), m; the target's rotation is nominal if not measured."""
        own = self.own_values(x)[0]
        R_base = rotation_matrix(own[3:6]) @ self.base_rotation
        R_tip = rotation_matrix(own[9:]) @ self.tip_rotation
        return _transform(R_base, own[:3]), _transform(R_tip, own[6:9])

    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Predicted minus measured: rotation vector (rad; full pose only), then position (m)."""
        if self.endpoint_m is None:
            raise ValueError("no endpoint measurements are bound to this model")
        if q.shape[-2] != len(self.endpoint_m):
            raise ValueError(
                f"{q.shape[-2]} poses for {len(self.endpoint_m)} endpoint measurements"
            )
        own = self.own_values(x)
        frames = self.frames(x, q, u)
        R_base = rotation_matrix(own[..., 3:6]) @ self.base_rotation
        lever = (frames.R_end @ own[..., 6:9, None])[..., 0]
        swung = (R_base @ (frames.p_end + lever)[..., None])[..., 0]
        position = own[..., :3] + swung - self.endpoint_m
        # Columns of the target in the base frame, turned into the instrument's.
        J = self.columns(frames, lever)
        jac_own = self._own_columns(own, R_base @ frames.R_end, swung)
        if self.endpoint_rotation is None:
            return self.loop_error(position, R_base @ J[..., 3:, :], jac_own[..., 3:, :])
        R_tip = R_base @ frames.R_end @ rotation_matrix(own[..., 9:12]) @ self.tip_rotation
        r = rotation_vector(R_tip @ np.swapaxes(self.endpoint_rotation, -1, -2))
        E = rotation_vector_differential(r)
        jac_own[..., :3, :] = E @ jac_own[..., :3, :]
        J = np.concatenate((E @ R_base @ J[..., :3, :], R_base @ J[..., 3:, :]), axis=-2)
        return self.loop_error(np.concatenate((r, position), axis=-1), J, jac_own)

    def equivalents(self, x: FloatArray) -> FloatArray:
        """Return equivalent parameter vectors (E, P): a rotation vector shorter by 2 pi describes the same rotation."""
        x = np.asarray(x, dtype=np.float64)
        names = [p.name for p in self.parameters]
        candidates = [x]
        for group in (BASE[3:], TIP_TURN):
            if all(name in names for name in group):
                columns = [names.index(name) for name in group]
                angle = float(np.linalg.norm(x[columns]))
                if angle > 1e-9:
                    for y in list(candidates):
                        z = y.copy()
                        z[columns] *= 1.0 - 2.0 * np.pi / angle
                        candidates.append(z)
        return np.stack(candidates)

    def at_poses(self, poses: IntArray) -> MeasuredClosure:
        """Return the model with the measurements of `poses` only."""
        return select_poses(self, poses, "endpoint_m", "endpoint_rotation")

    def fixture_axis(self, x: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return the measured position of the target, m, in the arm's base frame, and zeros, as a target has no axis.

        The result is None unless exactly one pose was measured.
        """
        if self.endpoint_m is None or len(self.endpoint_m) != 1:
            return None
        own = self.own_values(x)[0]
        R_base = rotation_matrix(own[3:6]) @ self.base_rotation
        return (self.endpoint_m[0] - own[:3]) @ R_base, np.zeros(3)

    def _own_columns(self, own: FloatArray, R_hand: FloatArray, swung: FloatArray) -> FloatArray:
        """Derivatives (..., m, 6, 12) of the target's rotation and position with respect to base_x .. tip_rz.

        `own` (..., 12): values of base_x .. tip_rz. `R_hand`: rotation of the flange in the instrument's frame.
        `swung`: vector from the base's origin to the target in the instrument's frame, m.
        """
        inverse = np.linalg.inv(rotation_vector_differential(own[..., 3:6]))
        right = np.linalg.inv(rotation_vector_differential(own[..., 9:12]))
        out = np.zeros((*R_hand.shape[:-2], 6, 12))
        out[..., 3:, 0:3] = np.eye(3)
        out[..., :3, 3:6] = inverse
        out[..., 3:, 3:6] = -np.cross(
            swung[..., :, None], np.broadcast_to(inverse, R_hand.shape), axis=-2
        )
        out[..., 3:, 6:9] = R_hand
        out[..., :3, 9:12] = R_hand @ right
        return out


def _transform(R: FloatArray, position_m: FloatArray) -> FloatArray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, position_m
    return T

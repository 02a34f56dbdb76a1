"""A point of the hand held at a point of the ground: the loop of a ball joint. Knows no fixture metal.

``p_n(q) + R_n(q) b - g = 0`` seen in the arm's base frame: b is the ball's centre in the flange frame n
(tip_x, tip_y, tip_z), g the socket's in the base frame (ground_x, ground_y, ground_z). The ball's own three
rotations are eliminated by not asking about orientation: three equations a pose [3], [5].
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray, frozen
from solver.chain.arm_chain import ArmChain
from solver.chain.parameters import Parameter
from solver.loops.closure import LoopError, ReducedError

TIP = ("tip_x", "tip_y", "tip_z")
GROUND = ("ground_x", "ground_y", "ground_z")


@dataclass(frozen=True, slots=True, kw_only=True)
class PointClosure:
    """An arm whose hand carries a ball in a socket; a `ClosureModel`.

    Attributes
    ----------
    chain
        The arm with its unknown entries and unsensed joints.
    tip_m, ground_m
        Nominal centre of the ball in the flange frame, and of the socket in the base frame, (3,).
    own
        Which of tip_x .. ground_z are unknown.
    """

    chain: ArmChain
    tip_m: FloatArray
    ground_m: FloatArray
    own: tuple[str, ...] = TIP + GROUND

    def __post_init__(self) -> None:
        for name in ("tip_m", "ground_m"):
            value = frozen(getattr(self, name))
            if value.shape != (3,):
                raise ValueError(f"{name} must have three components")
            object.__setattr__(self, name, value)
        if not set(self.own) <= set(TIP + GROUND) or len(set(self.own)) != len(self.own):
            raise ValueError(f"a point contact has the unknowns {TIP + GROUND}, each once")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The arm's unknown entries, then tip and ground."""
        nominal = dict(
            zip(TIP + GROUND, np.concatenate((self.tip_m, self.ground_m)).tolist(), strict=True)
        )
        return self.chain.parameters + tuple(
            Parameter(name=name, is_angle=False, nominal=nominal[name]) for name in self.own
        )

    @property
    def joint_count(self) -> int:
        """Joints of the arm."""
        return self.chain.joints

    @property
    def unsensed_joints(self) -> tuple[int, ...]:
        """Arm joints (1-based) whose readings are not used."""
        return self.chain.unsensed_joints

    @property
    def equations_per_pose(self) -> int:
        """Three, less one for each unsensed joint."""
        return 3 - len(self.unsensed_joints)

    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Distance from socket to ball (m), in the base frame, and its exact derivatives."""
        x = np.asarray(x, dtype=np.float64)
        split = len(self.chain.entries)
        tip, ground = self._contact(x[..., split:])
        frames = self.chain.frames(x[..., :split], q, u)
        lever = (frames.R_end @ tip[..., None, :, None])[..., 0]
        columns = self.chain.columns_at(frames, lever)
        entries, sensed, unsensed = self.chain.split(columns[..., 3:, :, :])
        residual = frames.p_end + lever - ground[..., None, :]
        own = np.concatenate(
            (frames.R_end, np.broadcast_to(-np.eye(3), frames.R_end.shape)), axis=-1
        )[..., self._indices()]
        return LoopError(
            residual=residual,
            jac_x=np.concatenate((entries, own), axis=-1),
            jac_q=sensed,
            jac_u=unsensed,
        )

    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Readings with nominal offsets for the unsensed joints; the ball has none to tell."""
        return self.chain.initial_unsensed(np.asarray(x, dtype=np.float64), q)

    def reduced(self, x: FloatArray, q: FloatArray) -> ReducedError:
        """Return the loop error: the ball's rotations are gone already, no row is a rotation.

        Raises
        ------
        ValueError
            If arm joints are unsensed: they have to be solved for (`loop`).
        """
        if self.unsensed_joints:
            raise ValueError("unsensed joints need `loop`")
        u = self.initial_unsensed(x, q)
        whole = self.loop(x, q, u)
        return ReducedError(
            residual=whole.residual,
            jac_x=whole.jac_x,
            rotation_rows=0,
            unsensed=u,
            flipped=np.zeros(whole.residual.shape[:-1], dtype=np.bool_),
        )

    def equivalents(self, x: FloatArray) -> FloatArray:
        """A point contact has one description of each loop."""
        return np.asarray(x, dtype=np.float64)[None, :]

    def with_all_joints_sensed(self) -> PointClosure:
        """Return the same loop with every joint's reading used and its offset an unknown."""
        return replace(self, chain=self.chain.with_all_joints_sensed())

    @property
    def ground_side(self) -> tuple[str, ...]:
        """ground_x .. ground_z, as far as unknown.

        The arm's theta_off_1 and s_1 stay the arm's: they are measured in its base frame, in which
        all sockets are seen, and no number of sockets tells them from a turn or a lift of them all.
        """
        return tuple(name for name in self.own if name in GROUND)

    @property
    def hand_side(self) -> tuple[str, ...]:
        """tip_x .. tip_z, as far as unknown."""
        return tuple(name for name in self.own if name in TIP)

    def without(self, names: Collection[str]) -> PointClosure:
        """Return the same loop with the named unknowns held at their nominal values."""
        return replace(
            self,
            chain=self.chain.without(names),
            own=tuple(name for name in self.own if name not in names),
        )

    def at_poses(self, poses: IntArray) -> PointClosure:
        """Return the loop itself: it is bound to no poses."""
        return self

    def tip_position(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Centre of the ball in the base frame for every pose (..., m, 3), m.

        Raises
        ------
        ValueError
            If arm joints are unsensed: then the readings alone do not tell.
        """
        ground = self._contact(np.asarray(x)[..., len(self.chain.entries) :])[1]
        return np.asarray(self.reduced(x, q).residual + ground[..., None, :])

    def _indices(self) -> list[int]:
        return [(TIP + GROUND).index(name) for name in self.own]

    def _contact(self, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        nominal = np.concatenate((self.tip_m, self.ground_m))
        whole = np.broadcast_to(nominal, (*own.shape[:-1], 6)).copy()
        whole[..., self._indices()] = own
        return whole[..., :3], whole[..., 3:]

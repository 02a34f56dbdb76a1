"""Base class for loops of one placement: an arm of D-H links with unknown entries, and the fixture's unknowns.

A subclass defines the links, the unknowns of its endpoint, and the closure error (`loop`).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np

from solver.arrays import FloatArray, frozen
from solver.chain.kinematics import DhTable, Entries, Frames, forward, jacobian
from solver.chain.parameters import DhEntry, DhKind, Parameter
from solver.chain.rotations import skew
from solver.loops.closure import ClosureModel, LoopError


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmLoop(ClosureModel):
    """A chain of D-H links with sensed and unsensed joints.

    `table`: nominal D-H table of the links; its first row is link `FIRST_LINK`.
    `entries`: unknown entries of the table. They come first in the parameter vector.
    `own`: names of the endpoint's unknowns, a part of `OWN`. They follow in the parameter vector.
    `unsensed_joints`: arm joints (1-based) whose readings are not used. Their angles are unknowns of each pose.
    """

    FIRST_LINK: ClassVar[int] = 1
    OWN: ClassVar[tuple[str, ...]] = ()
    OWN_ANGLES: ClassVar[tuple[str, ...]] = ()
    GROUND_SIDE: ClassVar[tuple[str, ...]] = ()
    """`OWN`: names of the unknowns that this kind of endpoint can have; `OWN_ANGLES`: of those that are angles.
    `GROUND_SIDE`: names of all unknowns, D-H entries included, that locate the fixture on the table."""
    ARRAYS: ClassVar[tuple[str, ...]] = ()
    """Fields that hold arrays."""

    table: DhTable
    entries: tuple[DhEntry, ...]
    unsensed_joints: tuple[int, ...] = ()
    own: tuple[str, ...] = ()
    # Computed once, since estimators need them at every step.
    parameters: tuple[Parameter, ...] = field(init=False, repr=False, compare=False)
    _stacked: FloatArray = field(init=False, repr=False, compare=False)
    _indices: tuple[list[int], list[int]] = field(init=False, repr=False, compare=False)
    _unknown: Entries = field(init=False, repr=False, compare=False)
    _moved: Entries = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in self.ARRAYS:
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, frozen(value))
        kinds = [int(e.kind) for e in self.entries]
        rows = [e.row - self.FIRST_LINK for e in self.entries]
        stacked = self.table.stacked()
        object.__setattr__(self, "_stacked", stacked)
        object.__setattr__(self, "_indices", (kinds, rows))
        angles = [DhKind.THETA_OFF] * self.table.links
        entries = Entries.of([*kinds, *angles], [*rows, *range(self.table.links)])
        object.__setattr__(self, "_moved", entries)
        object.__setattr__(self, "_unknown", Entries.of(kinds, rows))
        nominal = dict(zip(self.OWN, self._own_nominal().tolist(), strict=True))
        unknowns = [
            (e.name, e.kind.is_angle, float(value))
            for e, value in zip(self.entries, stacked[kinds, rows], strict=True)
        ]
        unknowns += [(name, name in self.OWN_ANGLES, nominal[name]) for name in self.own]
        parameters = (Parameter(name=n, is_angle=a, nominal=v) for n, a, v in unknowns)
        object.__setattr__(self, "parameters", tuple(parameters))

    def _own_nominal(self) -> FloatArray:
        """Return the nominal values (O,) of all O unknowns in `OWN`, in this order."""
        return np.zeros(0)

    @property
    def joint_count(self) -> int:
        """Number n of joints of the arm."""
        return self.table.links - 1 + self.FIRST_LINK

    @property
    def ground_side(self) -> tuple[str, ...]:
        """Names of those unknowns that locate the fixture on the table."""
        return tuple(p.name for p in self.parameters if p.name in self.GROUND_SIDE)

    @property
    def hand_side(self) -> tuple[str, ...]:
        """Names of those unknowns in `own` that locate the fixture on the tool."""
        return tuple(name for name in self.own if name not in self.GROUND_SIDE)

    def arm_rows(self) -> FloatArray:
        """Nominal rows 1..n (5, n): theta_off, s, a, alpha, beta."""
        return self.table.stacked()[:, 1 - self.FIRST_LINK :]

    @property
    def unsensed_rows(self) -> tuple[int, ...]:
        """Links whose angle is an unknown of each pose."""
        return self.unsensed_joints

    @property
    def equations_per_pose(self) -> int:
        """Number of closure components minus number of unsensed angles."""
        return self.components - len(self.unsensed_rows)

    def tables(self, x: FloatArray) -> FloatArray:
        """Return the nominal table with parameter vectors (..., P) inserted: (..., 5, links)."""
        x = np.asarray(x, dtype=np.float64)
        stacked = np.empty((*x.shape[:-1], *self._stacked.shape))
        stacked[...] = self._stacked
        kinds, rows = self._indices
        stacked[..., kinds, rows] = x[..., : len(self.entries)]
        return stacked

    def own_values(self, x: FloatArray) -> FloatArray:
        """Return values (..., 1, O) of all unknowns in `OWN`: from `x` (..., P) if they are in `own`, else nominal."""
        x = np.asarray(x, dtype=np.float64)
        values = np.broadcast_to(self._own_nominal(), (*x.shape[:-1], len(self.OWN))).copy()
        values[..., self._own_indices()] = x[..., len(self.entries) :]
        # The axis of length 1 stands for the poses, in all of which the values are the same.
        return values[..., None, :]

    def frames(self, x: FloatArray, q: FloatArray, u: FloatArray) -> Frames:
        """All frames of the chain at every pose, expressed in its first frame."""
        table = self.tables(x)[..., None, :, :]
        offsets = table[..., 0, :]
        theta = np.empty((*np.broadcast(offsets[..., 0], q[..., 0]).shape, self.table.links))
        theta[...] = offsets
        theta[..., 1 - self.FIRST_LINK :] += q
        for k, row in enumerate(self.unsensed_rows):
            theta[..., row - self.FIRST_LINK] = u[..., k]
        return forward(theta, *np.moveaxis(table[..., 1:, :], -2, 0))

    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Readings of the unsensed joints plus their nominal offsets, (..., m, U), rad."""
        lost = [j - 1 for j in self.unsensed_joints]
        offsets = self.table.theta_off_rad[[j - self.FIRST_LINK for j in self.unsensed_joints]]
        lead = np.broadcast_shapes((*np.shape(x)[:-1], 1), q.shape[:-1])
        return np.broadcast_to(q[..., lost] + offsets, (*lead, len(lost))).copy()

    def with_all_joints_sensed(self) -> Self:
        """Return the same loop with the readings of all joints used; offsets of unsensed joints become unknowns."""
        if not self.unsensed_joints:
            return self
        offsets = tuple(DhEntry(DhKind.THETA_OFF, j) for j in self.unsensed_joints)
        return replace(self, entries=self.entries + offsets, unsensed_joints=())

    def without(self, names: Collection[str]) -> Self:
        """Return the same loop with the named unknowns fixed at their nominal values."""
        if not names:
            return self
        return replace(
            self,
            entries=tuple(e for e in self.entries if e.name not in names),
            own=tuple(name for name in self.own if name not in names),
        )

    def freed(self, entries: Sequence[DhEntry]) -> Self:
        """Return the same loop with `entries` of the arm's table as additional unknowns."""
        known = set(self.entries)
        new = tuple(e for e in entries if e not in known)
        return replace(self, entries=self.entries + new)

    def drawn(self, x: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return points (n + 2, 3), m, at angles `q` (n,): origins of frames 0..n, ball or target. The axis is zero."""
        frames = self.frames(x, q[None, :], np.zeros((1, len(self.unsensed_joints))))
        tip = self.OWN.index("tip_x")
        point = frames.p_end + frames.R_end[0] @ self.own_values(x)[0, tip : tip + 3]
        return np.concatenate((frames.origins_m[0], point)), np.zeros(3)

    def columns(self, frames: Frames, lever_m: FloatArray | None = None) -> FloatArray:
        """Return the Jacobian (..., 6, E + links) of the chain's end for E unknown D-H entries, then all links' angles.

        A column is a small rotation w (rad), then the translation v of the end (m), in the chain's first frame. With
        `lever_m` (..., 3), the vector from the end to a point, v is replaced by this point's ``v + w x lever``.
        """
        J = jacobian(frames, self._moved)
        if lever_m is not None:
            J[..., 3:, :] -= skew(lever_m) @ J[..., :3, :]
        return J

    def loop_error(
        self, residual: FloatArray, J: FloatArray, jac_own: FloatArray | None = None
    ) -> LoopError:
        """Return the loop error for the k closure components `residual` (..., k).

        `J` (..., k, E + links): their derivatives with respect to E unknown D-H entries, then the angles of all links.
        `jac_own` (..., k, O): their derivatives with respect to the O unknowns in `OWN`.
        """
        split = len(self.entries)
        jac_x, jac_theta = J[..., :split], J[..., split:]
        jac_q = jac_theta[..., 1 - self.FIRST_LINK :]
        if self.unsensed_joints:
            jac_q = jac_q.copy()
            jac_q[..., [j - 1 for j in self.unsensed_joints]] = 0.0
        if jac_own is not None:
            jac_x = np.concatenate((jac_x, jac_own[..., self._own_indices()]), axis=-1)
        unsensed = [row - self.FIRST_LINK for row in self.unsensed_rows]
        return LoopError(
            residual=residual, jac_x=jac_x, jac_q=jac_q, jac_u=jac_theta[..., unsensed]
        )

    def _own_indices(self) -> list[int]:
        return [self.OWN.index(name) for name in self.own]

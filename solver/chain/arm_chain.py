"""An arm as an open chain with unknown entries: where its last frame is and how that answers. Knows no fixture.

For endpoint models that are not D-H links themselves (`PointClosure`, `MeasuredClosure`): link 1 starts
in the arm's base frame 0, link n ends in the flange frame n.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable, Frames, forward, jacobian
from solver.chain.parameters import DhEntry, DhKind, Parameter


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmChain:
    """Links 1..n of an arm, with the entries that are unknown and the joints that are not read.

    Attributes
    ----------
    table
        Nominal D-H rows 1..n.
    entries
        Unknown entries; their rows are 1..n.
    unsensed_joints
        Arm joints (1-based) whose readings are not used; their angles are unknowns of each pose.
    """

    table: DhTable
    entries: tuple[DhEntry, ...]
    unsensed_joints: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        n = self.table.links
        if any(not 1 <= e.row <= n for e in self.entries):
            raise ValueError("a free entry names a link the arm does not have")
        if len(set(self.entries)) != len(self.entries):
            raise ValueError("a free entry is listed twice")
        if any(not 1 <= j <= n for j in self.unsensed_joints):
            raise ValueError("an unsensed joint is none of the arm's")
        if any(e.kind is DhKind.THETA_OFF and e.row in self.unsensed_joints for e in self.entries):
            raise ValueError(f"joints {self.unsensed_joints} are unsensed: they have no offset")

    @property
    def joints(self) -> int:
        """Number n of joints."""
        return self.table.links

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknown entries with their nominal values."""
        stacked = self.table.stacked()
        return tuple(
            Parameter(
                name=e.name, is_angle=e.kind.is_angle, nominal=float(stacked[e.kind, e.row - 1])
            )
            for e in self.entries
        )

    def frames(self, x: FloatArray, q: FloatArray, u: FloatArray) -> Frames:
        """All frames, seen in the base frame.

        Parameters
        ----------
        x
            Values of `entries` (..., P).
        q, u
            Joint readings (..., m, n) and angles theta' of the unsensed joints (..., m, U), rad.
        """
        stacked = np.broadcast_to(self.table.stacked(), (*x.shape[:-1], 4, self.joints)).copy()
        kinds, rows = self._indices()
        stacked[..., kinds, rows] = x
        table = stacked[..., None, :, :]
        theta = np.array(table[..., 0, :] + q)
        for k, joint in enumerate(self.unsensed_joints):
            theta[..., joint - 1] = u[..., k]
        return forward(theta, table[..., 1, :], table[..., 2, :], table[..., 3, :])

    def columns_at(self, frames: Frames, lever_m: FloatArray) -> FloatArray:
        """Screw columns (..., 6, 4, n) of a point of the flange `lever_m` (..., 3) from its origin.

        The lever is seen in the base frame: ``v_tip = v_end + w x lever``.
        """
        columns = jacobian(frames)
        turning = np.moveaxis(columns[..., :3, :, :], -3, -1)
        columns[..., 3:, :, :] += np.moveaxis(
            np.cross(turning, lever_m[..., None, None, :]), -1, -3
        )
        return columns

    def split(self, columns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pick the columns of the unknown entries, of the joints as read and of the unsensed joints."""
        kinds, rows = self._indices()
        lost = [j - 1 for j in self.unsensed_joints]
        joints = columns[..., DhKind.THETA_OFF, :]
        sensed = joints.copy()
        sensed[..., lost] = 0.0
        return columns[..., kinds, rows], sensed, joints[..., lost]

    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Readings with nominal offsets, for the unsensed joints: (..., m, U), rad."""
        lost = [j - 1 for j in self.unsensed_joints]
        lead = np.broadcast_shapes((*x.shape[:-1], 1), q.shape[:-1])
        return np.broadcast_to(
            q[..., lost] + self.table.theta_off_rad[lost], (*lead, len(lost))
        ).copy()

    def with_all_joints_sensed(self) -> ArmChain:
        """Return the chain with every reading used and its offset an unknown."""
        offsets = tuple(DhEntry(DhKind.THETA_OFF, j) for j in self.unsensed_joints)
        return replace(self, entries=self.entries + offsets, unsensed_joints=())

    def without(self, names: Collection[str]) -> ArmChain:
        """Return the chain with the named entries held at their nominal values."""
        return replace(self, entries=tuple(e for e in self.entries if e.name not in names))

    def _indices(self) -> tuple[list[int], list[int]]:
        return [int(e.kind) for e in self.entries], [e.row - 1 for e in self.entries]

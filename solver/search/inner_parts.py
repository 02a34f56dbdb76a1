"""Which inner problem a loop poses, and how its answer becomes the loop's whole parameter vector.

The bridge between the models of fixtures and `inner_search`, which knows none of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhKind, wrap_angle
from solver.loops.closure import ClosureModel, DhLoop
from solver.loops.endpoint_geometry import HeldAxis, held_frame_entries
from solver.loops.placements import Placements
from solver.loops.point import PointClosure
from solver.search.inner import Hold, InnerProblem


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One placement: its loop, its poses, and the inner problem they make."""

    model: DhLoop | PointClosure
    columns: IntArray
    q: FloatArray
    problem: InnerProblem

    def filled(self, offsets: FloatArray) -> FloatArray:
        """Parameters (P,) of this placement's loop for inner offsets (K,)."""
        held = self.problem.held(offsets)
        n = self.model.joint_count
        values = {
            f"theta_off_{j}": float(wrap_angle(v))
            for j, v in zip(self.problem.searched, offsets, strict=True)
        }
        if isinstance(self.model, PointClosure):
            values |= _point_entries(self.model, held.point_m, held.ground_point_m)
        elif self.model.hinge:
            values |= HeldAxis(
                ground_direction=held.ground_direction,
                ground_point_m=held.ground_point_m,
                hand_direction=held.direction,
                hand_point_m=held.point_m,
            ).entries(n)
        else:
            values |= held_frame_entries(held.rotation, held.ground_point_m, n)
        return np.array([values.get(p.name, p.nominal) for p in self.model.parameters])


def _point_entries(
    model: PointClosure, hand_m: FloatArray, ground_m: FloatArray
) -> dict[str, float]:
    """Ball and socket from points of the frames without theta_off_1, s_1, theta_off_n and row n."""
    table = model.chain.table
    # The ends of the arm as a chain of their own: links n and 1 at their nominal values.
    c, s = np.cos(table.theta_off_rad), np.sin(table.theta_off_rad)
    ca, sa = np.cos(table.alpha_rad[-1]), np.sin(table.alpha_rad[-1])
    x, y, z = hand_m
    along, across, up = (
        c[-1] * x + s[-1] * y - table.a_m[-1],
        c[-1] * y - s[-1] * x,
        z - table.s_m[-1],
    )
    tip = (along, ca * across + sa * up, ca * up - sa * across)
    x, y, z = ground_m
    ground = (c[0] * x - s[0] * y, s[0] * x + c[0] * y, z + table.s_m[0])
    names = ("tip_x", "tip_y", "tip_z", "ground_x", "ground_y", "ground_z")
    return dict(zip(names, map(float, (*tip, *ground)), strict=True))


def projectable_parts(model: ClosureModel, q: FloatArray) -> list[Part]:
    """Placements whose fixture can be projected out; none if there is one whose cannot."""
    everything = np.arange(len(model.parameters))
    pieces = (
        model.parts()
        if isinstance(model, Placements)
        else ((model, everything, np.arange(len(q))),)
    )
    parts = []
    for piece, columns, poses in pieces:
        if not isinstance(piece, DhLoop | PointClosure):
            return []
        here = q[poses]
        parts.append(Part(model=piece, columns=columns, q=here, problem=_inner(piece, here)))
    return parts


def _inner(model: DhLoop | PointClosure, q: FloatArray) -> InnerProblem:
    n = model.joint_count
    if isinstance(model, PointClosure):
        stacked, hold, entries = model.chain.table.stacked(), Hold.POINT, model.chain.entries
    else:
        stacked = model.table.stacked()[:, 1:]
        hold, entries = (Hold.AXIS if model.hinge else Hold.FRAME), model.entries
    stacked = stacked.copy()
    stacked[[DhKind.THETA_OFF, DhKind.S], 0] = 0.0
    stacked[:, -1] = 0.0
    reach = float(np.abs(stacked[[DhKind.S, DhKind.A]]).sum())
    return InnerProblem(
        table=DhTable(
            theta_off_rad=stacked[DhKind.THETA_OFF],
            s_m=stacked[DhKind.S],
            a_m=stacked[DhKind.A],
            alpha_rad=stacked[DhKind.ALPHA],
        ),
        searched=tuple(e.row for e in entries if e.kind is DhKind.THETA_OFF and 1 < e.row < n),
        hold=hold,
        q=q,
        # Half an arm's length counts as one radian.
        per_m=2.0 / reach if reach > 0.0 else 1.0,
    )

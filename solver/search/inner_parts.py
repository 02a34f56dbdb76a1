"""Which inner problem a loop poses, and how its answer becomes the loop's whole parameter vector.

The bridge between the models of fixtures and `inner_search`, which knows none of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhKind, wrap_angle
from solver.loops.closure import ClosureModel, Hold, Which
from solver.search.inner import InnerProblem


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One placement: its loop, its poses, and the inner problem they make."""

    model: ClosureModel
    columns: Which
    q: FloatArray
    problem: InnerProblem

    def filled(self, offsets: FloatArray) -> FloatArray:
        """Parameters (P,) of this placement's loop for inner offsets (K,)."""
        values = {
            f"theta_off_{j}": float(wrap_angle(v))
            for j, v in zip(self.problem.searched, offsets, strict=True)
        }
        values |= self.model.held_entries(self.problem.held(offsets))
        return np.array([values.get(p.name, p.nominal) for p in self.model.parameters])


def projectable_parts(model: ClosureModel, q: FloatArray) -> list[Part]:
    """Placements whose fixture can be projected out; none if there is one whose cannot."""
    parts = []
    for piece, columns, poses in model.parts():
        if piece.hold is None:
            return []
        here = q[poses]
        problem = _inner(piece, piece.hold, here)
        parts.append(Part(model=piece, columns=columns, q=here, problem=problem))
    return parts


def _inner(model: ClosureModel, hold: Hold, q: FloatArray) -> InnerProblem:
    n = model.joint_count
    stacked = model.arm_rows()
    stacked[[DhKind.THETA_OFF, DhKind.S], 0] = 0.0
    stacked[:, -1] = 0.0
    reach = float(np.abs(stacked[[DhKind.S, DhKind.A]]).sum())
    return InnerProblem(
        table=DhTable.from_stacked(stacked),
        searched=tuple(
            e.row for e in model.entries if e.kind is DhKind.THETA_OFF and 1 < e.row < n
        ),
        hold=hold,
        q=q,
        # Half an arm's length counts as one radian.
        per_m=2.0 / reach if reach > 0.0 else 1.0,
    )

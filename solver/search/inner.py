"""Estimates the offsets of the inner joints alone, with the fixture's unknowns projected out.

The part constrained by a passive fixture does not move in the base frame. With M_i = R_1 .. R_{n-1} Rz(theta_n) and
p_i the origin of frame n-1 at pose i,

    hinge:  M_i h = const (a line of the tool keeps its direction),  p_i + M_i t = const (and its place),
    ball:                                                          p_i + M_i t = const,
    rigid:  M_i   = const,                                         p_i = const.

For given offsets of joints 2 .. n-1 the tool's h and t and the constants follow in closed form: h is the
dominant right singular vector of the mean of M_i, t solves linear equations, the constants are means. So a
hinge problem with 14 unknowns is a search over 5 angles (variable projection, Golub & Pereyra, with
Kaufman's Jacobian), without any guess about the fixture. The direction of the line is common to all
poses, so a pose on the flipped branch never looks closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable, Frames, forward
from solver.chain.parameters import DhKind, wrap_angle
from solver.estimators.load_effects import farthest
from solver.loops.closure import ClosureModel, ConstrainedPart, Which
from solver.loops.endpoint_geometry import Line

RIDGE = 1e-9
"""Ridge that keeps the projection defined if t may slide along h; too small to affect the result."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InnerProblem:
    """A `BatchProblem` over the offsets of some inner joints in one placement.

    `model`, `columns`: loop of the placement, and the indices of its parameters in the whole vector. `table`: D-H rows
    1..n; the offsets of joints 1 and n, s_1, and the lengths and twists of row n are zero. `searched`: joints (1-based)
    whose offsets are sought, never 1 or n; the offsets of the others keep their values. `q`: joint angles (m, n), rad.
    `per_m`: weight of positions relative to directions, 1/m.
    """

    model: ClosureModel
    columns: Which
    table: DhTable
    searched: tuple[int, ...]
    q: FloatArray
    per_m: float

    def __call__(self, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (S, R) and their Jacobian (S, R, K) at offsets (S, K), with the fixture projected out."""
        frames = self._frames(offsets)
        M, p = frames.R_end, frames.p_end
        before = [j - 1 for j in self.searched]
        z = frames.axes[..., 2][..., before, :]
        o = frames.origins_m[..., before, :]
        M_c = M - M.mean(-3, keepdims=True)
        rows, rates, basis = [], [], []
        if self.model.constrained_part is ConstrainedPart.FRAME:
            for k in range(3):
                rows.append(M_c[..., k])
                rates.append(np.cross(z, M[..., None, :, k]))
            end, by_point = p, None
        else:
            h, t = self._projected(M, M_c, p)
            end = p + (M @ t[:, None, :, None])[..., 0]
            by_point = self.per_m * M_c
            if self.model.constrained_part is ConstrainedPart.AXIS:
                direction = (M @ h[:, None, :, None])[..., 0]
                rows.append(direction)
                rates.append(np.cross(z, direction[..., None, :]))
                zero = np.zeros_like(M_c)
                basis.append(np.concatenate((M_c @ _tangents(h)[:, None], zero), axis=-1))
                by_point = np.concatenate((zero[..., :2], by_point), axis=-1)
        rows.append(self.per_m * end)
        rates.append(self.per_m * np.cross(z, end[..., None, :] - o))
        if by_point is not None:
            basis.append(by_point)
        count = len(offsets)
        # The table's constants are means over the poses, so subtracting the means projects them out.
        r = np.stack(rows, axis=-2)
        r = (r - r.mean(-3, keepdims=True)).reshape(count, -1)
        J = np.swapaxes(np.stack(rates, axis=-3), -1, -2)
        J = (J - J.mean(1, keepdims=True)).reshape(count, r.shape[1], -1)
        if not basis:
            return r, J
        L = np.stack(basis, axis=-3).reshape(count, r.shape[1], -1)
        Lt = np.swapaxes(L, -1, -2)
        N = Lt @ L + RIDGE * len(self.q) * np.eye(L.shape[-1])
        return r, J - L @ np.linalg.solve(N, Lt @ J)

    def filled(self, offsets: FloatArray) -> FloatArray:
        """Parameters (P,) of the placement's loop for joint offsets (K,)."""
        values = {
            f"theta_off_{j}": float(wrap_angle(v))
            for j, v in zip(self.searched, offsets, strict=True)
        }
        values |= self.model.constraint_entries(*self._constraint(offsets))
        return np.array([values.get(p.name, p.nominal) for p in self.model.parameters])

    def _constraint(self, offsets: FloatArray) -> tuple[Line, Line, FloatArray]:
        """Lines of table and tool, and the tool's mean rotation, for given offsets (K,)."""
        frames = self._frames(offsets[None, :])
        M, p = frames.R_end, frames.p_end
        mean = M.mean(-3, keepdims=True)
        h, t = self._projected(M, M - mean, p)
        along = mean[0, 0] @ h[0]
        point = (p + (M @ t[:, None, :, None])[..., 0]).mean(-2)[0]
        ground = Line(point_m=point, direction=along / np.linalg.norm(along))
        return ground, Line(point_m=t[0], direction=h[0]), mean[0, 0]

    def _frames(self, offsets: FloatArray) -> Frames:
        theta = np.broadcast_to(self.q, (len(offsets), *self.q.shape)) + self.table.theta_off_rad
        for k, joint in enumerate(self.searched):
            theta[..., joint - 1] = offsets[:, None, k] + self.q[:, joint - 1]
        return forward(theta, *self.table.stacked()[1:])

    def _projected(
        self, M: FloatArray, M_c: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Best direction h (S, 3) and point t (S, 3) of the tool; t is zero for a rigid fixture."""
        count = len(M)
        if self.model.constrained_part is ConstrainedPart.FRAME:
            return np.tile([0.0, 0.0, 1.0], (count, 1)), np.zeros((count, 3))
        h = np.linalg.svd(M.mean(-3))[2][:, 0]
        A = M_c.reshape(count, -1, 3)
        b = (p - p.mean(-2, keepdims=True)).reshape(count, -1, 1)
        At = np.swapaxes(A, -1, -2)
        t = -np.linalg.solve(At @ A + RIDGE * M.shape[1] * np.eye(3), At @ b)[..., 0]
        return h, t


def _tangents(h: FloatArray) -> FloatArray:
    """Two unit vectors perpendicular to each unit vector (S, 3), as columns (S, 3, 2)."""
    first = np.cross(h, np.eye(3)[np.argmin(np.abs(h), axis=-1)])
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack((first, np.cross(h, first)), axis=-1)


def spread_poses(q: FloatArray, count: int) -> FloatArray:
    """Choose `count` of the poses (m, n), far from each other; the order of the poses does not matter.

    Farthest-point selection over the points (cos q, sin q); the first is the pose farthest from the mean.
    """
    points = np.concatenate((np.cos(q), np.sin(q)), axis=-1)
    points -= points.mean(0)
    return q[farthest(points, count, first=int(np.argmax((points**2).sum(-1))))]


def projectable_parts(model: ClosureModel, q: FloatArray) -> list[InnerProblem]:
    """Return the inner problem of each placement; an empty list if a fixture cannot be projected out."""
    parts = []
    n = model.joint_count
    for piece, columns, poses in model.parts():
        if piece.constrained_part is None:
            return []
        stacked = piece.arm_rows()
        stacked[[DhKind.THETA_OFF, DhKind.S], 0] = 0.0
        stacked[:, -1] = 0.0
        reach = float(np.abs(stacked[[DhKind.S, DhKind.A]]).sum())
        parts.append(
            InnerProblem(
                model=piece,
                columns=columns,
                table=DhTable.from_stacked(stacked),
                searched=tuple(
                    e.row for e in piece.entries if e.kind is DhKind.THETA_OFF and 1 < e.row < n
                ),
                q=q[poses],
                # Half an arm's length counts as one radian.
                per_m=2.0 / reach if reach > 0.0 else 1.0,
            )
        )
    return parts

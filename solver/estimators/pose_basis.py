"""Smooth functions of the pose: a few columns that span deflections that repeat at the same pose.

A Gaussian process over joint space with several scales at once and a linear part, in low rank: its
values at all poses are ``Phi b`` with b ~ N(0, I) and ``Phi`` (m, k), made from poses far apart
(Nystroem), so its cost grows with the poses and not with their square. Knows no loop and no parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray

CENTRES = 64
"""Poses, as far apart as there are, from which the others are interpolated."""

CHUNK = 1024
"""Poses computed at a time."""

SCALES_RAD = (np.deg2rad(60.0), np.deg2rad(120.0))
WEIGHTS = (0.5, 0.5)
"""Shares of the variance at each scale."""

CONSTANT, LINEAR = 0.5, 0.5
"""Variance of the constant and of the linear part, in addition to that of the scales."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseBasis:
    """Smooth columns.

    Attributes
    ----------
    phi
        (m, k).
    missed
        (m,): share of the variance at each pose that so few columns leave out.
    """

    phi: FloatArray
    missed: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseProcess:
    """The process in low rank, before the few columns are chosen.

    Attributes
    ----------
    values
        (m, c), one column for each centre.
    turn
        (c, c): from these to orthogonal columns, the largest first.
    variance
        (m,): variance of the process itself.
    """

    values: FloatArray
    turn: FloatArray
    variance: FloatArray

    def leading(self, columns: int) -> PoseBasis:
        """Return the columns of largest variance."""
        phi = self.values @ self.turn[:, :columns]
        return PoseBasis(phi=phi, missed=np.maximum(self.variance - (phi**2).sum(-1), 0.0))


def pose_process(q: FloatArray, *, group: IntArray | None = None) -> PoseProcess:
    """Return the process over joint angles `q` (m, n), rad; independent in each `group` (m,) of poses."""
    spread = np.maximum(q.std(axis=0), 1e-9)
    moving = np.ptp(q, axis=0) > np.deg2rad(0.5)
    angle = q[:, moving]
    linear = (angle - angle.mean(axis=0)) / (spread[moving] * np.sqrt(max(1, moving.sum())))
    group = np.zeros(len(q), dtype=np.int64) if group is None else group
    far = farthest(np.column_stack((angle, 10.0 * group)), CENTRES)

    def kernel(one: IntArray, two: IntArray) -> FloatArray:
        a, b = angle[one], angle[two]
        d2 = np.maximum((a**2).sum(-1)[:, None] + (b**2).sum(-1)[None, :] - 2.0 * (a @ b.T), 0.0)
        k = CONSTANT + LINEAR * (linear[one] @ linear[two].T)
        for scale, weight in zip(SCALES_RAD, WEIGHTS, strict=True):
            k = k + weight * np.exp(-0.5 * d2 / scale**2)
        return np.asarray(k * (group[one][:, None] == group[two][None, :]))

    values, vectors = np.linalg.eigh(kernel(far, far))
    good = values > 1e-8 * values[-1]
    if len(far) == len(q):
        # Every pose is a centre: the columns are orthogonal already.
        whole = vectors[:, good] * np.sqrt(values[good])
        turn = np.eye(whole.shape[1])
    else:
        root = vectors[:, good] / np.sqrt(values[good])
        parts = np.array_split(np.arange(len(q)), -(-len(q) // CHUNK))
        whole = np.concatenate([kernel(part, far) @ root for part in parts])
        turn = np.linalg.eigh(whole.T @ whole)[1]
    diagonal = CONSTANT + sum(WEIGHTS) + LINEAR * (linear**2).sum(-1)
    return PoseProcess(values=whole, turn=turn[:, ::-1], variance=diagonal)


def farthest(points: FloatArray, count: int) -> IntArray:
    """Indices of points (m, d) chosen one by one, each the farthest from those before."""
    if len(points) <= count:
        return np.arange(len(points))
    distance = ((points - points.mean(axis=0)) ** 2).sum(-1)
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(int(np.argmax(distance if chosen else -distance)))
        near = ((points - points[chosen[-1]]) ** 2).sum(-1)
        distance = near if len(chosen) == 1 else np.minimum(distance, near)
    return np.array(chosen)

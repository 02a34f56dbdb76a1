"""What the chain does while drive joints go straight to a target: the trace of every joint.

Drive joints are held at points of the straight line and all others follow by closing the loops, many
lines in one batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.closing import close_loops, held_still
from solver.design.manifold import Ranges
from solver.design.motion import chain_motion
from solver.loops.closure import ClosureModel

LOST_RAD = 0.25
"""A correction larger than this beside the predicted step means the chain jumped to another branch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveTraces:
    """What b straight drive moves do, sampled at s + 1 points each.

    Attributes
    ----------
    q, u
        (b, s + 1, n) and (b, s + 1, U), rad.
    leverage
        (b, s + 1) of the drive joints; 0 at a fold.
    rate
        (b,): largest motion of any arm joint per motion of the faster drive joint.
    closed
        (b,): whether the chain could be followed to the end of the line.
    """

    q: FloatArray
    u: FloatArray
    leverage: FloatArray
    rate: FloatArray
    closed: BoolArray

    def safe(self, ranges: Ranges, *, least_leverage: float, most_rate: float) -> BoolArray:
        """Which lines (b,) stay inside the ranges, away from folds, and slow enough everywhere."""
        return np.asarray(
            self.closed
            & (ranges.clearance(self.q).min(-1) >= 0.0)
            & (self.leverage.min(-1) >= least_leverage)
            & (self.rate <= most_rate)
        )


def drive_straight(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    u: FloatArray,
    drives: Sequence[int],
    targets_rad: FloatArray,
    *,
    steps: int,
) -> DriveTraces:
    """Follow b moves from closed poses `q` (b, n), `u` (b, U) to drive angles `targets_rad` (b, d).

    Parameters
    ----------
    drives
        Joints (1-based) in position mode; the rest is free.
    steps
        Points each line is divided into.
    """
    columns = [j - 1 for j in drives]
    held = held_still(drives, q.shape[-1])
    start = q[:, columns]
    share = np.linspace(0.0, 1.0, steps + 1)
    here_q, here_u = np.array(q), np.array(u)
    closed = np.ones(len(q), dtype=np.bool_)
    trace_q, trace_u, trace_leverage = [], [], []
    fastest = np.zeros(len(q))
    for k in range(steps + 1):
        motion = chain_motion(model, x, here_q, here_u)
        trace_q.append(here_q.copy())
        trace_u.append(here_u.copy())
        trace_leverage.append(motion.leverage(drives))
        if k == steps:
            break
        line = start + share[k + 1] * (targets_rad - start)
        by_drive = line - here_q[:, columns]
        rows = motion.tangent[:, columns, :]
        along = np.linalg.pinv(rows) @ by_drive[..., None]
        whole = (motion.tangent @ along)[..., 0]
        n = q.shape[-1]
        # Past a fold the prediction is meaningless; the line counts as lost there.
        lost = np.abs(whole).max(-1) > 4.0 * LOST_RAD
        whole[lost] = 0.0
        first_q, first_u = here_q + whole[:, :n], here_u + whole[:, n:]
        first_q[:, columns] = line
        found = close_loops(
            model, x, first_q, u=first_u, sigma_rad=held, max_iterations=6, tolerance=1e-11
        )
        jumped = np.abs(found.q - first_q).max(-1) > LOST_RAD
        closed &= found.closed & ~jumped & ~lost
        step = np.abs(found.q - here_q).max(-1) / np.maximum(np.abs(by_drive).max(-1), 1e-12)
        moves = np.abs(by_drive).max(-1) > 1e-9
        fastest = np.where(closed & moves, np.maximum(fastest, step), fastest)
        here_q = np.where(closed[:, None], found.q, here_q)
        here_u = np.where(closed[:, None], found.u, here_u)
    return DriveTraces(
        q=np.stack(trace_q, axis=1),
        u=np.stack(trace_u, axis=1),
        leverage=np.stack(trace_leverage, axis=1),
        rate=fastest,
        closed=closed,
    )

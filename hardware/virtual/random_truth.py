"""Truths drawn by seed: another hinge, other offsets. Knows no sensor and no plant."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hardware.virtual.truth import LoopTruth, paper_loop
from solver.arrays import FloatArray, frozen
from solver.chain.kinematics import DhTable
from solver.chain.parameters import entries, nominal_vector, wrap_angle
from solver.closing import close_loops
from solver.loops.dh import DhLoop

PLACEMENT = ("a_0", "s_0", "alpha_0", "s_1", "a_7", "s_7", "alpha_7")
"""D-H entries that say where the hinge is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WildSpread:
    """How far a wild truth lies from the paper's, and how far it must be able to move.

    Attributes
    ----------
    pose_rad, hinge_m, hinge_rad
        Half widths of uniform draws: of every joint of the true home pose (and so of the offsets)
        before the loop is closed again, and of the hinge's lengths and angles.
    smallest_crossing_rad
        Least angle between the hinge axis and its neighbours' (nearly parallel ones are for
        Hayati's parameters, not for D-H).
    drives, lowest_rad, highest_rad
        Two joints, and the corners of the box of their angles, relative to home, that the arm must
        be able to cover without a fold.
    room_rad
        (n,) how far each joint may get from home on the way.
    steepest
        Largest motion of any joint over the motion of the drives; it grows without bound at a fold.
    """

    pose_rad: float = float(np.deg2rad(25.0))
    hinge_m: float = 0.04
    hinge_rad: float = float(np.deg2rad(15.0))
    smallest_crossing_rad: float = float(np.deg2rad(20.0))
    drives: tuple[int, int] = (1, 5)
    lowest_rad: FloatArray = field(default_factory=lambda: frozen(np.deg2rad([-30.0, -70.0])))
    highest_rad: FloatArray = field(default_factory=lambda: frozen(np.deg2rad([48.0, 0.0])))
    room_rad: FloatArray = field(
        default_factory=lambda: frozen(np.deg2rad([72.0] * 5 + [57.0] * 2))
    )
    steepest: float = 4.0


def wild_loop(
    rng: np.random.Generator, *, spread: WildSpread, reading_rad: FloatArray
) -> LoopTruth:
    """Draw a truth; its loop is closed exactly where the sensors read `reading_rad`.

    Parameters
    ----------
    reading_rad
        Home in sensor coordinates, shape (n,). Joint ranges are about this reading: offsets may be
        anything without a joint leaving its range.
    """
    loop = DhLoop(table=paper_loop().table, entries=entries(PLACEMENT), hinge=True)
    nominal = nominal_vector(loop.parameters)
    reach = np.where([p.is_angle for p in loop.parameters], spread.hinge_rad, spread.hinge_m)
    twists = [PLACEMENT.index("alpha_0"), PLACEMENT.index("alpha_7")]
    home = np.asarray(reading_rad, dtype=np.float64)
    while True:
        x = nominal + reach * rng.uniform(-1.0, 1.0, reach.shape)
        q = home + spread.pose_rad * rng.uniform(-1.0, 1.0, home.shape)
        if np.any(np.abs(np.sin(x[twists])) < np.sin(spread.smallest_crossing_rad)):
            continue
        closed = close_loops(loop, x, q[None, :])
        pose = closed.q[0]
        if (
            bool(closed.closed[0])
            and not bool(loop.reduced(x, closed.q).flipped[0])
            and bool(np.all(np.abs(pose - home) < 2.0 * spread.pose_rad))
            and can_cover(loop, x, pose, closed.u[0], spread)
        ):
            table = loop.tables(x)
            table[0] = wrap_angle(table[0] + np.concatenate(([0.0], pose - home)))
            return LoopTruth(table=DhTable.from_stacked(table))


def can_cover(
    loop: DhLoop, x: FloatArray, pose: FloatArray, hinge: FloatArray, spread: WildSpread
) -> bool:
    """Whether the two drives can go straight from `pose` to the edge of their box all round.

    Follows a bundle of rays in small steps, all rays at once, each step started from the last.
    """
    edge = np.linspace(0.0, 1.0, 5)[:-1]
    square = np.concatenate(
        [
            np.stack(side, axis=-1)
            for side in (
                (edge, 0.0 * edge),
                (1.0 + 0.0 * edge, edge),
                (1.0 - edge, 1.0 + 0.0 * edge),
                (0.0 * edge, 1.0 - edge),
            )
        ]
    )
    ends = spread.lowest_rad + square * (spread.highest_rad - spread.lowest_rad)
    drives = [j - 1 for j in spread.drives]
    passive = np.ones(pose.shape)
    passive[drives] = 0.0
    q = np.tile(pose, (len(ends), 1))
    u = np.tile(hinge, (len(ends), 1))
    steps = 12
    for k in range(1, steps + 1):
        before = q.copy()
        q[:, drives] = pose[drives] + ends * (k / steps)
        closed = close_loops(loop, x, q, sigma_rad=passive, u=u, max_iterations=8)
        stride = np.abs(ends).max(-1, keepdims=True) / steps
        if not (
            bool(np.all(closed.closed))
            and bool(np.all(np.abs(closed.q - before) <= spread.steepest * stride + 1e-9))
            and bool(np.all(np.abs(closed.q - pose) <= spread.room_rad))
        ):
            return False
        q, u = closed.q.copy(), closed.u.copy()
    return True

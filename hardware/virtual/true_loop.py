"""True geometry (the truth) of the virtual arm's loop, fixed or drawn at random."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hardware.virtual.loop_point import BallPoint, ChainPoint, LoopPoint
from solver.arrays import FloatArray, frozen
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, nominal_vector, wrap_angle
from solver.closing import close_loops
from solver.loops.dh import DhLoop
from solver.loops.open_arm import MeasuredClosure
from solver.loops.point import PointClosure


@dataclass(frozen=True, slots=True)
class Truth:
    """True geometry of an arm and its fixture: a closure model without unknowns, in sensor coordinates.

    The fixture is a hinge or a rigid attachment (`DhLoop`), or a ball on the tool in a socket on the table
    (`PointClosure`). An open arm has a target on its tool (`MeasuredClosure`, not bound to measurements).
    """

    loop: DhLoop | PointClosure | MeasuredClosure

    @property
    def table(self) -> DhTable:
        """D-H rows 0..n: row 0 is the fixture (zero unless `loop` is a `DhLoop`), rows 1..n the arm's true values."""
        if isinstance(self.loop, DhLoop):
            return self.loop.table
        rows = self.loop.table.stacked()
        return DhTable.from_stacked(np.column_stack((np.zeros(len(rows)), rows)))

    @property
    def joint_count(self) -> int:
        """Number n of joints of the arm."""
        return self.loop.joint_count

    @property
    def offsets_rad(self) -> FloatArray:
        """True offsets of joints 1..n, shape (n,)."""
        return self.table.theta_off_rad[1:]

    def named(self) -> dict[str, float]:
        """Return the true values (rad, m) by parameter name; of base, tip and ground, only positions are included."""
        stacked, points = self.table.stacked(), dict[str, FloatArray]()
        match self.loop:
            case PointClosure(tip_m=tip, ground_m=ground):
                points = {"tip": tip, "ground": ground}
            case MeasuredClosure(tip_m=tip, base_m=base):
                points = {"base": base, "tip": tip}
        rows = [DhEntry(kind=kind, row=row) for kind in DhKind for row in range(stacked.shape[1])]
        return {entry.name: float(stacked[entry.kind, entry.row]) for entry in rows} | {
            f"{name}_{axis}": float(value)
            for name, point in points.items()
            for axis, value in zip("xyz", point, strict=True)
        }

    def point(self) -> ChainPoint:
        """Return the evaluator of frames and closure error at one pose, for the plant's inner loop."""
        match self.loop:
            case DhLoop(hinge=hinge):
                return LoopPoint(self.table, hinge=hinge)
            case PointClosure(tip_m=tip, ground_m=ground):
                return BallPoint(self.table, tip_m=tip, ground_m=ground)
        return ChainPoint(self.table)

    def closed_near(self, reading_rad: FloatArray) -> tuple[FloatArray, float]:
        """Find the closed pose nearest to a reading (n,), rad, in sensor coordinates; `ValueError` if there is none.

        Returns true joint angles theta' (n,) and hinge angle theta_0 (0 without a hinge), rad.
        """
        loop, nothing = self.loop, np.zeros(0)
        start = np.asarray(reading_rad, dtype=np.float64)[None, :]
        if isinstance(loop, MeasuredClosure):  # open at any pose
            return start[0] + self.offsets_rad, 0.0
        flipped = bool(loop.reduced(nothing, start).flipped[0])
        closed = close_loops(loop, nothing, start)
        if flipped or not bool(closed.closed[0]):
            raise ValueError("this loop does not close near the given pose")
        return closed.q[0] + self.offsets_rad, float(closed.u[0].sum())


def hinge_truth(table: DhTable) -> Truth:
    """Return the truth of an arm in a hinge, from D-H rows 0..n."""
    return Truth(DhLoop(table=table, entries=(), hinge=True))


def paper_loop() -> Truth:
    """Return the geometry of the paper's tables 1 and 2: rows 0 (hinge) to 7."""
    return hinge_truth(
        DhTable(
            theta_off_rad=np.deg2rad([0.0, 9.9, -122.8, -21.1, -9.2, 27.1, 116.3, 89.3]),
            s_m=frozen([0.014, 0.273, 0.0, 0.355, 0.0, 0.320, 0.0, 0.038]),
            a_m=frozen([0.202, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.101]),
            alpha_rad=np.deg2rad([-38.5, 90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 99.8]),
        )
    )


PAPER_HOME_RAD = frozen(
    np.deg2rad([40.5311, 245.5792, 143.1309, -115.0631, -189.2465, -215.6707, 44.9482])
)
"""A closed pose of `paper_loop`, sensor coordinates (exact to the digits given; hinge -118.936 deg)."""


def with_length_errors(
    truth: Truth, range_m: tuple[float, float], rng: np.random.Generator
) -> Truth:
    """Add a random error, of a magnitude within `range_m`, to every length from the maker's table.

    These are s_2..s_n-1 and a_1..a_n-1; the fixture's entries (s_1, s_n, a_n, row 0) are identified.
    """
    n = truth.joint_count
    fixed = {"s_m": slice(2, n), "a_m": slice(1, n)}
    columns = {}
    for name, rows in fixed.items():
        column = np.array(getattr(truth.table, name))
        size = rng.uniform(*range_m, column[rows].shape)
        column[rows] += size * rng.choice((-1.0, 1.0), column[rows].shape)
        columns[name] = column
    stacked = replace(truth.table, **columns).stacked()[:, -truth.loop.table.links :]
    return Truth(truth.loop.with_table(DhTable.from_stacked(stacked)))


PLACEMENT_ENTRIES = ("a_0", "s_0", "alpha_0", "s_1", "a_7", "s_7", "alpha_7")
"""D-H entries of the hinge's placement."""


# Spread of a `wild` truth around the paper's, half widths of uniform draws.
WILD_POSE_RAD = float(np.deg2rad(25.0))
"""Largest change of each joint's true home angle (and so of its offset) before the loop is closed again."""
WILD_HINGE_M, WILD_HINGE_RAD = 0.04, float(np.deg2rad(15.0))
"""Largest differences of the lengths and angles of a `wild` hinge from those of the paper's hinge."""
SMALLEST_CROSSING_RAD = float(np.deg2rad(20.0))
"""Smallest angle between the hinge axis and its neighbours (D-H degenerates for parallel axes)."""

# Motion that a `wild` truth must allow, relative to home, without a singularity.
WILD_DRIVES = [0, 4]
"""The two driven joints (indices from 0); relative to home, they must cover LOWEST_RAD to HIGHEST_RAD."""
LOWEST_RAD, HIGHEST_RAD = frozen(np.deg2rad([-30.0, -70.0])), frozen(np.deg2rad([48.0, 0.0]))
ROOM_RAD = frozen(np.deg2rad([72.0] * 5 + [57.0] * 2))
"""Largest distance of each joint from home while the drives cover their ranges."""
MAX_GRADIENT = 4.0
"""Largest ratio of a joint's motion to the drives' motion; infinite at a singularity."""


def draw_wild_loop(rng: np.random.Generator) -> Truth:
    """Draw a true loop that closes exactly at `PAPER_HOME_RAD`."""
    entries = tuple(DhEntry.parse(name) for name in PLACEMENT_ENTRIES)
    loop = DhLoop(table=paper_loop().table, entries=entries, hinge=True)
    nominal = nominal_vector(loop.parameters)
    reach = np.where([p.is_angle for p in loop.parameters], WILD_HINGE_RAD, WILD_HINGE_M)
    twists = [PLACEMENT_ENTRIES.index("alpha_0"), PLACEMENT_ENTRIES.index("alpha_7")]
    home = PAPER_HOME_RAD
    while True:
        x = nominal + reach * rng.uniform(-1.0, 1.0, reach.shape)
        q = home + WILD_POSE_RAD * rng.uniform(-1.0, 1.0, home.shape)
        if np.any(np.abs(np.sin(x[twists])) < np.sin(SMALLEST_CROSSING_RAD)):
            continue
        closed = close_loops(loop, x, q[None, :])
        pose = closed.q[0]
        if (
            bool(closed.closed[0])
            and not bool(loop.reduced(x, closed.q).flipped[0])
            and bool(np.all(np.abs(pose - home) < 2.0 * WILD_POSE_RAD))
            and can_cover(loop, x, pose, closed.u[0])
        ):
            table = loop.tables(x)
            table[0] = wrap_angle(table[0] + np.concatenate(([0.0], pose - home)))
            return hinge_truth(DhTable.from_stacked(table))


def can_cover(loop: DhLoop, x: FloatArray, pose: FloatArray, hinge: FloatArray) -> bool:
    """Whether the drives can move straight from `pose` to 16 points on the border of their ranges, in small steps."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    sides = np.roll(corners, -1, axis=0) - corners
    square = np.concatenate([corners + 0.25 * step * sides for step in range(4)])
    ends = LOWEST_RAD + square * (HIGHEST_RAD - LOWEST_RAD)
    passive = np.ones(pose.shape)
    passive[WILD_DRIVES] = 0.0
    q = np.tile(pose, (len(ends), 1))
    u = np.tile(hinge, (len(ends), 1))
    steps = 12
    for k in range(1, steps + 1):
        before = q.copy()
        q[:, WILD_DRIVES] = pose[WILD_DRIVES] + ends * (k / steps)
        closed = close_loops(loop, x, q, sigma_rad=passive, u=u, max_iterations=8)
        stride = np.abs(ends).max(-1, keepdims=True) / steps
        if not (
            bool(np.all(closed.closed))
            and bool(np.all(np.abs(closed.q - before) <= MAX_GRADIENT * stride + 1e-9))
            and bool(np.all(np.abs(closed.q - pose) <= ROOM_RAD))
        ):
            return False
        q, u = closed.q.copy(), closed.u.copy()
    return True

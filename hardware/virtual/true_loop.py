"""True geometry (the truth) of the virtual arm's loop, fixed or drawn at random."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from hardware.virtual.loop_point import BallPoint, ChainPoint, LoopPoint, OpenPoint
from solver.arrays import FloatArray, frozen
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, nominal_vector, wrap_angle
from solver.closing import close_loops
from solver.loops.arm_loop import ArmLoop
from solver.loops.dh import DhLoop
from solver.loops.open_arm import MeasuredClosure
from solver.loops.point import PointClosure


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth(ABC):
    """True geometry of an arm and its fixture.

    `table`: D-H rows 0..n; row 0 is the fixture (`theta_off_rad[0]` is 0), rows 1..n the arm with its true offsets.
    """

    table: DhTable

    @property
    def joint_count(self) -> int:
        """Number n of joints of the arm."""
        return self.table.links - 1

    @property
    def offsets_rad(self) -> FloatArray:
        """True offsets of joints 1..n, shape (n,)."""
        return self.table.theta_off_rad[1:]

    @property
    def arm_table(self) -> DhTable:
        """Rows 1..n: the arm without fixture."""
        return DhTable.from_stacked(self.table.stacked()[:, 1:])

    def named(self) -> dict[str, float]:
        """Return the true values, rad and m, by the parameter names of a calibration."""
        stacked = self.table.stacked()
        return {
            DhEntry(kind=kind, row=row).name: float(stacked[kind, row])
            for kind in DhKind
            for row in range(self.table.links)
        }

    @abstractmethod
    def loop(self) -> ArmLoop:
        """Return the closure model without unknowns, in sensor coordinates."""

    @abstractmethod
    def point(self) -> ChainPoint:
        """Return the evaluator of the closure error at one pose, for the plant's inner loop."""

    def closed_near(self, reading_rad: FloatArray) -> tuple[FloatArray, float]:
        """Find the closed pose nearest to a reading (n,), rad, in sensor coordinates; `ValueError` if there is none.

        Returns true joint angles theta' (n,) and hinge angle theta_0 (0 without a hinge), rad.
        """
        loop, nothing = self.loop(), np.zeros(0)
        start = np.asarray(reading_rad, dtype=np.float64)[None, :]
        flipped = bool(loop.reduced(nothing, start).flipped[0])
        closed = close_loops(loop, nothing, start)
        if flipped or not bool(closed.closed[0]):
            raise ValueError("this loop does not close near the given pose")
        return closed.q[0] + self.offsets_rad, float(closed.u[0].sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopTruth(Truth):
    """An arm whose fixture, link 0, is a hinge or, with ``hinge=False``, a rigid attachment."""

    hinge: bool = True

    def loop(self) -> DhLoop:
        """Return the closed chain of links 0..n."""
        return DhLoop(table=self.table, entries=(), hinge=self.hinge)

    def point(self) -> LoopPoint:
        """Return the evaluator of the six closure components."""
        return LoopPoint(self.table, hinge=self.hinge)


@dataclass(frozen=True, slots=True, kw_only=True)
class BallTruth(Truth):
    """An arm with a ball on its tool, in a socket on the table; row 0 of `table` is zero.

    `tip_m`, `ground_m` (3,): centres of the ball in the last frame, and of the socket in the arm's base frame.
    """

    tip_m: FloatArray
    ground_m: FloatArray

    def named(self) -> dict[str, float]:
        """Return the D-H entries and both centres, by name."""
        return Truth.named(self) | _axes(tip=self.tip_m, ground=self.ground_m)

    def loop(self) -> PointClosure:
        """Return the closure model of ball and socket."""
        arm = self.arm_table
        return PointClosure(table=arm, entries=(), own=(), tip_m=self.tip_m, ground_m=self.ground_m)

    def point(self) -> BallPoint:
        """Return the evaluator of the three closure components."""
        return BallPoint(self.table, tip_m=self.tip_m, ground_m=self.ground_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenTruth(Truth):
    """An open arm with a target on its tool; row 0 of `table` is zero.

    `base_m` (3,), `base_rotation` (3, 3): the arm's base in the instrument's frame; `tip_m`, `tip_rotation`: the target
    in the last frame.
    """

    base_m: FloatArray
    base_rotation: FloatArray
    tip_m: FloatArray
    tip_rotation: FloatArray

    def named(self) -> dict[str, float]:
        """Return D-H entries and positions of base and target, by name."""
        return Truth.named(self) | _axes(base=self.base_m, tip=self.tip_m)

    def loop(self) -> MeasuredClosure:
        """Return the closure model of the target, not yet bound to measurements."""
        return MeasuredClosure(
            table=self.arm_table,
            entries=(),
            base_m=self.base_m,
            base_rotation=self.base_rotation,
            tip_m=self.tip_m,
            tip_rotation=self.tip_rotation,
            full_pose=True,
        )

    def point(self) -> OpenPoint:
        """Return the evaluator of the frames, without closure components."""
        return OpenPoint(self.table)

    def closed_near(self, reading_rad: FloatArray) -> tuple[FloatArray, float]:
        """Return the true joint angles (n,) at a reading (n,), rad, and 0 for the hinge angle; there is no closure."""
        return np.asarray(reading_rad) + self.offsets_rad, 0.0

    def target(self, theta_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the target's position (3,) m and orientation (3, 3) in the instrument's frame at theta' (n,) rad."""
        q = (np.asarray(theta_rad) - self.offsets_rad)[None]
        position, rotation = self.loop().predicted(np.zeros(0), q)
        return position[0], rotation[0]


def _axes(**points: FloatArray) -> dict[str, float]:
    return {
        f"{name}_{axis}": float(value)
        for name, point in points.items()
        for axis, value in zip("xyz", point, strict=True)
    }


def paper_loop() -> LoopTruth:
    """Return the geometry of the paper's tables 1 and 2: rows 0 (hinge) to 7."""
    return LoopTruth(
        table=DhTable(
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
    truth: Truth, *, smallest_m: float, largest_m: float, rng: np.random.Generator
) -> Truth:
    """Add a random error of magnitude `smallest_m` to `largest_m` to every length from the maker's table.

    These are s_2..s_n-1 and a_1..a_n-1; the fixture's entries (s_1, s_n, a_n, row 0) are identified.
    """
    n = truth.joint_count
    fixed = {"s_m": slice(2, n), "a_m": slice(1, n)}
    columns = {}
    for name, rows in fixed.items():
        column = np.array(getattr(truth.table, name))
        size = rng.uniform(smallest_m, largest_m, column[rows].shape)
        column[rows] += size * rng.choice((-1.0, 1.0), column[rows].shape)
        columns[name] = column
    return replace(truth, table=replace(truth.table, **columns))


PLACEMENT_ENTRIES = ("a_0", "s_0", "alpha_0", "s_1", "a_7", "s_7", "alpha_7")
"""D-H entries of the hinge's placement."""


# Spread of a `wild` truth around the paper's, half widths of uniform draws.
WILD_POSE_RAD = float(np.deg2rad(25.0))
"""Largest change of each joint's true home angle (and so of its offset) before the loop is closed again."""
WILD_HINGE_M, WILD_HINGE_RAD = 0.04, float(np.deg2rad(15.0))
"""Largest changes of the hinge's lengths and angles."""
SMALLEST_CROSSING_RAD = float(np.deg2rad(20.0))
"""Smallest angle between the hinge axis and its neighbours (D-H degenerates for parallel axes)."""

# Motion that a `wild` truth must allow, relative to home, without a singularity.
WILD_DRIVES = [0, 4]
"""The two drive joints (indices from 0), which must cover the angles from LOWEST_RAD to HIGHEST_RAD from home."""
LOWEST_RAD, HIGHEST_RAD = frozen(np.deg2rad([-30.0, -70.0])), frozen(np.deg2rad([48.0, 0.0]))
ROOM_RAD = frozen(np.deg2rad([72.0] * 5 + [57.0] * 2))
"""Largest distance of each joint from home while the drives cover their ranges."""
MAX_GRADIENT = 4.0
"""Largest ratio of a joint's motion to the drives' motion; infinite at a singularity."""


def draw_wild_loop(rng: np.random.Generator) -> LoopTruth:
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
            return LoopTruth(table=DhTable.from_stacked(table))


def can_cover(loop: DhLoop, x: FloatArray, pose: FloatArray, hinge: FloatArray) -> bool:
    """Whether the drives can move straight from `pose` to 16 points on the border of their ranges, in small steps."""
    edge = np.linspace(0.0, 1.0, 5)[:-1]
    zeros, ones = np.zeros(4), np.ones(4)
    square = np.stack(
        (
            np.concatenate((edge, ones, 1.0 - edge, zeros)),
            np.concatenate((zeros, edge, ones, 1.0 - edge)),
        ),
        axis=-1,
    )
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

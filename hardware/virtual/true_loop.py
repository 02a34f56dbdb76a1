"""True geometry (the truth) of the virtual arm's loop, fixed or drawn at random, and its evaluation at one pose.

`ChainPoint` is optimised for speed in the plant's inner loop. `solver.loops.dh.DhLoop.loop` does the same for many
poses at once, and is ten times slower for one pose. A test compares the two to within 1e-12.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, frozen
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, nominal_vector, wrap_angle
from solver.closing import close_loops
from solver.loops.dh import DhLoop
from solver.loops.endpoints import MeasuredClosure, PointClosure

_CYCLIC = np.array([0, 1, 2, 0, 1])


class ChainPoint:
    """Evaluates ``A_0(theta_0) A_1 ... A_n`` at one pose; every call of `at` overwrites the previous result.

    This class is for an open arm and has no closure error; subclasses add one.
    """

    def __init__(self, table: DhTable, components: int = 0) -> None:
        links = table.links
        c, s = np.cos(table.alpha_rad), np.sin(table.alpha_rad)
        # Rows of A_j are linear in cos theta and sin theta: A = cos * even + sin * odd + constant.
        even, odd = np.zeros((links, 4, 4)), np.zeros((links, 4, 4))
        constant = np.zeros((links, 4, 4))
        even[:, 0, 0], even[:, 0, 3] = 1.0, table.a_m
        even[:, 1, 1], even[:, 1, 2] = c, -s
        odd[:, 0, 1], odd[:, 0, 2] = -c, s
        odd[:, 1, 0], odd[:, 1, 3] = 1.0, table.a_m
        constant[:, 2, 1], constant[:, 2, 2], constant[:, 2, 3] = s, c, table.s_m
        constant[:, 3, 3] = 1.0
        twisted = np.zeros((links, 4, 4))
        twisted[:, 1, 1] = twisted[:, 3, 3] = 1.0
        twisted[:, 0, 0] = twisted[:, 2, 2] = np.cos(table.beta_rad)
        twisted[:, 0, 2], twisted[:, 2, 0] = np.sin(table.beta_rad), -np.sin(table.beta_rad)
        even, odd, constant = even @ twisted, odd @ twisted, constant @ twisted
        self._even, self._odd, self._constant = even, odd, constant
        self._links = np.empty((links, 4, 4))
        self._frames = np.empty((links + 1, 4, 4))
        self._frames[0] = np.eye(4)
        frames = self._frames
        self._products = list(zip(frames[:-1], self._links, frames[1:], strict=True))
        self.base_axes = self._frames[1, :3, :3]
        self.axes_z = self._frames[:, :3, 2]
        self.origins_m = self._frames[:, :3, 3]
        """(n + 2, 3) z axis and origin of frames -1 .. n, in frame -1."""
        self.error = np.zeros(components)
        """(k,) closure error; its components are stated by the subclass."""
        self.jacobian = np.zeros((components, links))
        """(k, n + 1) derivative of `error` with respect to theta_0, theta'_1 .. theta'_n; column 0: 0 without hinge."""
        # Axis and origin of every joint, (2, x y z x y, n + 1): a cross product is two products of slices.
        self._joints = np.empty((2, 5, links))
        self._axes_and_origins = self._frames[:-1, :3, 2:].transpose(2, 1, 0)
        self._lever = np.empty((5, links))

    def at(self, theta_rad: FloatArray) -> FloatArray:
        """Compute all frames at true angles theta_0, theta'_1 .. theta'_n (n + 1,), rad; return frame n (4, 4)."""
        cosine, sine = np.cos(theta_rad), np.sin(theta_rad)
        np.multiply(self._even, cosine[:, None, None], out=self._links)
        self._links += self._odd * sine[:, None, None]
        self._links += self._constant
        dot = np.dot
        for before, link, after in self._products:
            dot(before, link, after)
        end: FloatArray = self._frames[-1]
        return end

    def _point_jacobian(self, p: FloatArray, rows: FloatArray) -> None:
        """Write the derivative of point `p` (3,) of the last link with respect to all angles into `rows` (3, n + 1)."""
        joints, lever = self._joints, self._lever
        joints[:, :3] = self._axes_and_origins
        joints[:, 3:] = joints[:, :2]
        np.subtract(p[_CYCLIC, None], joints[1], out=lever)
        z = joints[0]
        np.multiply(z[1:4], lever[2:], out=rows)
        rows -= z[2:] * lever[1:4]


class LoopPoint(ChainPoint):
    """Chain in a hinge or rigid fixture, from frame -1 to frame n; it is closed if these two frames coincide.

    The closure error is a rotation vector (rad), then a position (m). Without `hinge`, theta_0 must stay 0.
    """

    def __init__(self, table: DhTable, *, hinge: bool = True) -> None:
        super().__init__(table, 6)
        self._hinge = hinge

    def at(self, theta_rad: FloatArray) -> FloatArray:
        """Compute frames, closure error and Jacobian at true angles (n + 1,), rad; return frame n (4, 4)."""
        end = super().at(theta_rad)
        r0, r1, r2 = _rotation_vector(end[:3, :3].tolist())
        p = end[:3, 3]
        self.error[:] = (r0, r1, r2, *p.tolist())
        J = self.jacobian
        self._point_jacobian(p, J[3:])
        # dr = E w with E = 1 - [r]/2 + f [r]^2 (solver.chain.rotations.rotation_vector_differential).
        square = r0 * r0 + r1 * r1 + r2 * r2
        f = _second_order_factor(math.sqrt(square))
        diagonal = 1.0 - f * square
        E = np.array(
            (
                (diagonal + f * r0 * r0, 0.5 * r2 + f * r0 * r1, -0.5 * r1 + f * r0 * r2),
                (-0.5 * r2 + f * r0 * r1, diagonal + f * r1 * r1, 0.5 * r0 + f * r1 * r2),
                (0.5 * r1 + f * r0 * r2, -0.5 * r0 + f * r1 * r2, diagonal + f * r2 * r2),
            )
        )
        J[:3] = E @ self.axes_z[:-1].T
        if not self._hinge:
            J[:, 0] = 0.0
        return end


class BallPoint(ChainPoint):
    """Chain with a ball at `tip_m` (3,) in frame n and its socket at `ground_m` (3,) in the base frame.

    The closure error is the ball's position minus the socket's, m. There is no link 0: row 0 of `table` is zero and
    theta_0 stays zero, so that frame -1 is the base frame.
    """

    def __init__(self, table: DhTable, *, tip_m: FloatArray, ground_m: FloatArray) -> None:
        super().__init__(table, 3)
        self._tip, self._ground = tip_m, ground_m

    def at(self, theta_rad: FloatArray) -> FloatArray:
        """Compute frames, closure error and Jacobian at true angles (n + 1,), rad; return frame n (4, 4)."""
        end = super().at(theta_rad)
        ball = end[:3, :3] @ self._tip + end[:3, 3]
        self.error[:] = ball - self._ground
        self._point_jacobian(ball, self.jacobian)
        self.jacobian[:, 0] = 0.0
        return end


def _rotation_vector(R: list[list[float]]) -> tuple[float, float, float]:
    """Return the rotation vector of a matrix, rad; the angle must be well below half a turn."""
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = R
    x, y, z = r21 - r12, r02 - r20, r10 - r01
    # 4 w^2 = 1 + trace; the quaternion's vector part is (x, y, z) / 4w.
    four_w2 = 1.0 + r00 + r11 + r22
    if four_w2 < 1e-3:
        raise ValueError("the loop is open by half a turn, which no fixture allows")
    w = 0.5 * math.sqrt(four_w2)
    x, y, z = x / (4.0 * w), y / (4.0 * w), z / (4.0 * w)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-150 else 2.0 * math.atan2(sine, w) / sine
    return x * scale, y * scale, z * scale


def _second_order_factor(angle: float) -> float:
    """Return ``(1 - (angle/2) cot(angle/2)) / angle^2``, whose series starts 1/12 + angle^2/720."""
    if angle < 1e-4:
        return 1.0 / 12.0 + angle * angle / 720.0
    half = 0.5 * angle
    return (1.0 - half / math.tan(half)) / (angle * angle)


@dataclass(frozen=True, slots=True)
class Truth:
    """True geometry of an arm and its fixture: a closure model without unknowns, in sensor coordinates.

    The fixture is a hinge or a rigid attachment (`DhLoop`), or a ball on the tool in a socket on the table
    (`PointClosure`). An open arm has a target on its tool (`MeasuredClosure`, here without measured poses).
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
    def offsets_rad(self) -> FloatArray:
        """True offsets of joints 1..n, shape (n,)."""
        return self.table.theta_off_rad[1:]

    def named(self) -> dict[str, float]:
        """Return the true D-H entries and points (base, tip, ground) by name, rad and m; rotations are left out."""
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
        """Return an evaluator of frames and closure error at one pose; the plant calls it several times per period."""
        match self.loop:
            case DhLoop(hinge=hinge):
                return LoopPoint(self.table, hinge=hinge)
            case PointClosure(tip_m=tip, ground_m=ground):
                return BallPoint(self.table, tip_m=tip, ground_m=ground)
        return ChainPoint(self.table)

    def closed_near(self, reading_rad: FloatArray) -> FloatArray:
        """Find the closed pose nearest to a reading (n,), rad, in sensor coordinates; `ValueError` if there is none.

        Returns the true angles theta_0 (hinge; 0 without one), theta'_1 .. theta'_n (n + 1,), rad.
        """
        loop, nothing = self.loop, np.zeros(0)
        start = np.asarray(reading_rad, dtype=np.float64)[None, :]
        if isinstance(loop, MeasuredClosure):  # open at any pose
            return np.append(0.0, start[0] + self.offsets_rad)
        flipped = bool(loop.reduced(nothing, start).flipped[0])
        closed = close_loops(loop, nothing, start)
        if flipped or not bool(closed.closed[0]):
            raise ValueError("this loop does not close near the given pose")
        return np.append(closed.u[0].sum(), closed.q[0] + self.offsets_rad)


def hinge_truth(table: DhTable) -> Truth:
    """Return the true geometry of an arm in a hinge; row 0 of `table` is the hinge, rows 1..n are the arm."""
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
    """Return `truth` with a random error, of a magnitude within `range_m`, in every length from the maker's table.

    The maker's lengths are a_1, and s and a of rows 2 to n - 1. The other lengths (s_1, s_n, a_n, row 0) depend on the
    fixture, and the calibration identifies them.
    """
    n = truth.loop.joint_count
    stacked = truth.table.stacked()
    for kind, rows in ((DhKind.S, slice(2, n)), (DhKind.A, slice(1, n))):
        size = rng.uniform(*range_m, stacked[kind, rows].shape)
        stacked[kind, rows] += size * rng.choice((-1.0, 1.0), size.shape)
    own = stacked[:, -truth.loop.table.links :]
    return Truth(replace(truth.loop, table=DhTable.from_stacked(own)))


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
"""Largest distance of each joint from home while the driven joints cover their ranges."""
MAX_GRADIENT = 4.0
"""Largest ratio of a joint's motion to that of the driven joints; at a singularity this ratio is infinite."""


def draw_wild_loop(rng: np.random.Generator) -> Truth:
    """Draw the true loop of scenario ``wild``, far from the paper's; it closes exactly at `PAPER_HOME_RAD`."""
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
    """Whether the two driven joints can cover their ranges from `pose` (n,), with the hinge at `hinge`, rad.

    The driven joints move straight to each of 16 points on the border of their ranges. On the way the loop, with the
    unknowns `x` (P,), must close, and all joints must stay within the limits `MAX_GRADIENT` and `ROOM_RAD`.
    """
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

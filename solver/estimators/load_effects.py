"""Columns for the sag of joints and the deflection of a fixture under load, from static equilibrium.

Sag: a joint's drive carries the arm, so the sag of joint j is a compliance times gravity's torque tau_j(q). The
compliance is positive and of unknown magnitude, so it is modelled as half-normal, |z| with z ~ N(0, 1). Its mean,
sqrt(2 / pi), gives the expected sag.

Deflection: the controller compensates gravity in the free joints, but with the stated masses. So the fixture has to
carry the error dtau_f of these torques. At rest, a virtual motion of the free joints does no work. With F the fixture's
wrench,

    J_f' F + dtau_f = 0,     N' F = 0

(Murray, Li & Sastry, *A Mathematical Introduction to Robotic Manipulation*, 1994, eq. 6.4). J_f are the columns of the
closure Jacobian for the free joints. N are those for the fixture's own degrees of freedom, about which the fixture
carries no moment. With ``F = E y``, ``E' N = 0``, and friction rho, which limits F at a singularity, the solution is

    F = -E (K K' + rho^2 I)^-1 K dtau_f,     K = E' J_f.

F is linear in the errors z of masses and centres (`solver.chain.statics`): F = W z, z ~ N(0, I). Which joints were in
position mode is not recorded, but their number is that of the loop's degrees of freedom. W has columns for up to
`MOST_DRIVE_SETS` such sets, with equal weights. The displacements under F have a covariance that follows from the
fixture's compliance (`solver.estimators.compliance`). The columns of deflection are the leading eigenvectors of this
covariance (by Nystroem's method), scaled to the stated rms over the poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from solver.arrays import (
    BLOCK_POSES,
    FloatArray,
    IntArray,
    evenly,
    join_poses,
    pose_slices,
    select_poses,
)
from solver.chain.statics import LinkMasses
from solver.closing import left_null_space
from solver.estimators.compliance import (
    ArmPoses,
    FixtureLoads,
    blocks,
    compliance_sizes,
    covariance,
    variance,
)
from solver.loops.closure import ClosureModel

UNMODELLED_SHARE = 0.15
"""Share of the variance of a stated sag or deflection that the stated loads do not explain."""

FRICTION_M = 0.1
"""rho: friction torque of a free joint per force at the fixture, N m/N."""

TOOL_SIDE_COMPLIANCE = 0.5
"""Compliance of the fixture's half on the tool, as a share of the compliance of the half on the table."""

MOST_DRIVE_SETS = 8
"""Largest number of sets of joints in position mode that are evaluated, chosen evenly from all."""

HALF_NORMAL_MEAN = np.sqrt(2.0 / np.pi)
"""Mean of a compliance whose mean square is 1: half-normal, since no compliance is negative."""

SAG_COLUMNS, DEFLECTION_COLUMNS = 3, 24
"""Number of columns for the twist of a joint, and for the fixture's deflection in one placement."""

CENTRES = 24
"""Number of poses, chosen far apart, from which the columns at the other poses are interpolated."""

SMALLEST = 1e-9
"""Eigenvalues below this share of the largest are due to rounding."""

LEAST_TORQUE_NM = 1e-6
"""Smallest torque of gravity that is not neglected."""


@dataclass(frozen=True, slots=True, eq=False)
class JointLoads:
    """Effects of gravity on n joints at m poses; twists are in units of each joint's stated sag.

    `expected` (m, n): expected twist. `columns` (m, n, c): what a coefficient of 1 adds to the expected twist.
    `missed` (m, n): variance of the twist that the columns leave out; 1 for a joint on which gravity has no lever arm.
    `side` (m, n): expected sign of gravity's torque, from -1 to 1. It tells to which side of its play a joint moves.
    """

    expected: FloatArray
    columns: FloatArray
    missed: FloatArray
    side: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoadBasis:
    """Effects of load at m poses, as columns in units of the stated sag and deflection; coefficients are ~ N(0, 1).

    `joints`: effects on the joints.
    `all_deflections` (M, k, c): columns of the deflection along the k closure components, for all M poses for which the
    basis was computed, for many poses in single precision. This array is large, so `at_poses` does not copy it.
    `rows` (m,): index of each pose in `all_deflections`.
    `deflection_missed` (m, k): variance of the deflection that the columns leave out.
    `gravity`: calculates the effects on the joints at other poses.
    """

    joints: JointLoads
    all_deflections: FloatArray
    rows: IntArray
    deflection_missed: FloatArray
    gravity: Gravity

    def deflection_at(self, poses: slice = slice(None)) -> FloatArray:
        """Return the columns (m, k, c) of the deflection at a slice of the poses, in units of its stated size."""
        return np.asarray(self.all_deflections[self.rows[poses]], dtype=np.float64)

    def modelled_deflection(self, stated: FloatArray, poses: slice) -> FloatArray:
        """Return the deflection's columns (m, k, c) in rad and m, for `stated` deflections (k,) of k directions."""
        # To save memory, the large array is scaled for some poses at a time.
        scale = np.sqrt(1.0 - UNMODELLED_SHARE) * stated
        return np.asarray(scale[:, None] * self.deflection_at(poses))

    def missed_variance(self, stated: FloatArray, poses: slice) -> FloatArray:
        """Return the variance (m, k), rad^2 and m^2, of deflection by load beyond that of `modelled_deflection`.

        `stated` (k,): stated deflection, rad and m. The deflection that no load causes, `UNMODELLED_SHARE` of the
        stated variance, is not included.
        """
        return np.asarray((1.0 - UNMODELLED_SHARE) * stated**2 * self.deflection_missed[poses])

    def at_poses(self, poses: IntArray) -> LoadBasis:
        """Return the effects at a selection of poses."""
        joints = select_poses(self.joints, poses, *JointLoads.__slots__)
        return replace(select_poses(self, poses, "rows", "deflection_missed"), joints=joints)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gravity:
    """Each joint's twist as a function of the torques of gravity, in units of the joint's stated sag.

    The s torques on joint j of the arm `part` are tau_j0, as stated, and errors tau_j1, ... (see `ArmPoses.torques`).
    `rate` (n,): the expected twist of joint j is ``rate_j tau_j0``; 0 for a joint on which gravity has no lever arm.
    `turn` (n, s, c): a value b of coefficient c adds ``b sum_i tau_ji turn_jic`` to the expected twist of joint j.
    `size` (n, s): rms deviation of joint j from its expected twist, for each N m of the torque tau_ji.
    """

    part: ArmPoses
    size: FloatArray
    turn: FloatArray
    rate: FloatArray

    @classmethod
    def of(cls, part: ArmPoses, torque: FloatArray) -> Gravity:
        """Return the twist as a function of the torque, scaled so that each joint's twist has rms 1 over m poses.

        `torque` (m, n, s): gravity's torques at these poses, N m (see `ArmPoses.torques`).
        """
        m, n, s = torque.shape
        cuts = pose_slices(m)
        rms = np.sqrt(sum(np.einsum("mns,mns->n", torque[cut], torque[cut]) for cut in cuts) / m)
        scale = np.where(rms > LEAST_TORQUE_NM, rms, np.inf)[:, None]
        # E[c^2] = 1 times the second moments of the torque, minus the square of the expected value.
        share = np.ones(s)
        share[0] = np.sqrt(1.0 - HALF_NORMAL_MEAN**2)
        gram = np.zeros((n, s, s))
        for cut in cuts:
            by_joint = (torque[cut] * (share / scale)).transpose(1, 0, 2)
            gram += by_joint.transpose(0, 2, 1) @ by_joint
        leading = np.linalg.eigh(gram)[1][..., ::-1][..., :SAG_COLUMNS]
        size = share / scale
        rate = HALF_NORMAL_MEAN / scale[:, 0]
        return cls(part=part, size=size, turn=size[..., None] * leading, rate=rate)

    def at(self, q: FloatArray) -> JointLoads:
        """Return the effects of gravity on the joints at joint angles `q` (m, n), rad."""
        part = replace(self.part, q=q, u=np.zeros((len(q), 0)))
        return self.effects(part.torques(slice(None)))

    def effects(self, torque: FloatArray) -> JointLoads:
        """Return how the torques of gravity, `torque` (m, n, s), N m (see `ArmPoses.torques`), affect the joints."""
        blocks = []
        for cut in pose_slices(len(torque)):
            block = torque[cut]
            columns = (block.transpose(1, 0, 2) @ self.turn).transpose(1, 0, 2)
            missed = np.maximum(((block * self.size) ** 2).sum(-1) - (columns**2).sum(-1), 0.0)
            missed = np.where(self.rate > 0.0, missed, 1.0)
            blocks.append(JointLoads(self.rate * block[..., 0], columns, missed, _side(block)))
        return join_poses(blocks, *JointLoads.__slots__)


def load_basis(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    u: FloatArray,
    masses: LinkMasses,
    *,
    stated_deflection: tuple[float, float],
    deflection_columns: int = DEFLECTION_COLUMNS,
) -> LoadBasis:
    """Return the columns for the effects of load at joint angles `q` (m, n) and unsensed angles `u` (m, U), rad.

    `x`: approximate parameters (P,). `stated_deflection`: the fixture's rotation (rad) and translation (m); only their
    ratio matters, as the weight of moments against forces. `deflection_columns`: number of columns for each placement.
    """
    m, k = len(q), model.components
    parts = model.parts()
    placements = [
        (
            np.arange(m)[of_poses],
            ArmPoses(model=part, x=x[of_part], q=q[of_poses], u=u[of_poses], masses=masses),
        )
        for part, of_part, of_poses in parts
    ]
    torque = np.empty((m, model.joint_count, placements[0][1].shapes))
    for poses, one in placements:
        for cut in pose_slices(len(poses)):
            torque[poses[cut]] = one.torques(cut)
    gravity = Gravity.of(placements[0][1], torque)
    joints = gravity.effects(torque)
    # The torques need most memory: with many poses they are computed again where needed.
    of_few = torque if m <= BLOCK_POSES else None
    del torque
    # With many poses this array needs most memory. Its columns are a basis, for which single precision is enough.
    single = m > BLOCK_POSES
    shape = m, k, deflection_columns * len(parts)
    deflection = np.zeros(shape, dtype=np.float32 if single else np.float64)
    missed = np.zeros((m, k))
    for number, (poses, one) in enumerate(placements if max(stated_deflection) > 0.0 else ()):
        torque_there = None if of_few is None else of_few[poses]
        ours = slice(number * deflection_columns, (number + 1) * deflection_columns)
        deflection[poses, :, ours], missed[poses] = _load_deflection(
            one, stated_deflection, deflection_columns, torque_there
        )
    return LoadBasis(
        joints=joints,
        all_deflections=deflection,
        rows=np.arange(m),
        deflection_missed=missed,
        gravity=gravity,
    )


def _side(torque: FloatArray) -> FloatArray:
    """Return the expected sign (m, n), from -1 to 1, of the torque on each joint; `torque`: see `ArmPoses.torques`."""
    from scipy.special import erf

    spread = np.sqrt(2.0 * (torque[..., 1:] ** 2).sum(-1))
    return np.asarray(erf(torque[..., 0] / np.maximum(spread, LEAST_TORQUE_NM)))


def _wrenches(
    part: ArmPoses, poses: IntArray | slice, torque: FloatArray | None = None
) -> FloatArray:
    """Return the fixture's wrenches W (m, k, 4 n, d) for d possible sets of joints in position mode (`driven_sets`).

    The axis 4 n is for errors of one sigma in each link's mass and centre, in the order of `ArmPoses.torques`.
    `torque`: torques of `part` at these poses, if already computed.
    """
    model = part.model
    error = model.loop(part.x, part.q[poses], part.u[poses])
    lost = [j - 1 for j in model.unsensed_joints]
    own = error.jac_u.shape[-1] - len(lost)
    J = error.jac_q.copy()
    J[..., lost] = error.jac_u[..., own:]
    E = left_null_space(error.jac_u[..., :own])
    torque = part.torques(poses) if torque is None else torque
    moments = torque[..., 1 : 1 + 4 * len(part.masses.mass_kg)]
    sets = driven_sets(model.joint_count, J.shape[-2] - own)
    free = np.array([[j for j in range(model.joint_count) if j not in driven] for driven in sets])
    # (m, sets, k, 4 n): the free joints of every set.
    wrenches = wrench_of(np.moveaxis(J[..., free], -2, -3), E[:, None], moments[:, free])
    return np.moveaxis(wrenches, 1, -1)


def _load_deflection(
    part: ArmPoses, stated_deflection: tuple[float, float], columns: int, torque: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return the columns (m, k, c) of the fixture's deflection, and the variance (m, k) that these columns leave out.

    The unit is the stated deflection. `columns`: c. `torque`: gravity's torque at all poses; if None, it is calculated
    for some poses at a time, to save memory.
    """
    m, k = len(part.q), part.model.components
    centres = farthest(part.q, CENTRES)
    # All poses at once if they are few; else the centres first, then all poses, some at a time.
    few = torque is not None
    first, of_centres = (np.arange(m), centres) if few else (centres, np.arange(len(centres)))
    W = _wrenches(part, first, torque)
    if not W.any():
        # With exact masses the gravity compensation has no error that could deflect the fixture.
        return np.zeros((m, k, columns)), np.zeros((m, k))
    # Every set of driven joints has the same weight, in moments and in forces.
    unit = np.ones((k, W.shape[-1]))
    for rows in blocks(k):
        size = np.sqrt((W[of_centres, rows] ** 2).sum((1, 2)).mean(0))
        unit[rows] = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    unit /= np.sqrt(W.shape[-1])
    s = compliance_sizes(stated_deflection, rotations=k - 3)
    size = np.array([stated_deflection[0]] * (k - 3) + [stated_deflection[1]] * 3)
    scale = np.divide(1.0, size, out=np.zeros(k), where=size > 0.0)
    sized = unit[:, None] * s[:, None, None]
    loads = _fixture_loads(part, first, W * sized)
    centre_loads = loads.at_poses(of_centres)
    across = covariance(loads, centre_loads, s)
    values, vectors = np.linalg.eigh(
        across.reshape(len(first), k, -1)[of_centres].reshape(-1, across.shape[-1])
    )
    good = values > SMALLEST * values[-1]
    # Keep the eigenvectors of the largest eigenvalues, which come last.
    count = min(columns, int(good.sum()))
    root = vectors[:, : -count - 1 : -1] / np.sqrt(values[: -count - 1 : -1])
    deflection = np.zeros((m, k, columns))
    missed = np.zeros((m, k))
    for cut in pose_slices(m):
        if not few:
            loads = _fixture_loads(part, cut, _wrenches(part, cut) * sized)
            across = covariance(loads, centre_loads, s)
        deflection[cut, :, :count] = (across @ root).reshape(-1, k, count) * scale[:, None]
        total = variance(loads, s) * scale**2
        missed[cut] = np.maximum(total - (deflection[cut] ** 2).sum(-1), 0.0)
    return deflection, missed


def _fixture_loads(part: ArmPoses, poses: IntArray | slice, W: FloatArray) -> FixtureLoads:
    """Return the loads on both halves of the fixture at a selection of poses.

    `W` (m, k, 4 n, d): result of `_wrenches`, times S (`solver.estimators.compliance`) and a weight for each of d sets.
    """
    axes = part.model.fixture_axes(part.x, part.q[poses], part.u[poses])
    share = np.array([1.0, TOOL_SIDE_COMPLIANCE]) / np.hypot(1.0, TOOL_SIDE_COMPLIANCE)
    halves = []
    for turn, size in zip(axes, share.tolist(), strict=True):
        T = np.zeros((*W.shape[:2], W.shape[1]))
        for rows in blocks(W.shape[1]):
            T[:, rows, rows] = turn
        fixed = bool((turn == np.eye(3)).all())
        halves.append((size, None if fixed else T))
    return FixtureLoads(pull=W.reshape(*W.shape[:2], -1), halves=tuple(halves))


def wrench_of(
    J: FloatArray, E: FloatArray, torque: FloatArray, friction_m: float = FRICTION_M
) -> FloatArray:
    """Return the fixture's wrenches (..., k, c) that keep f free joints at rest, for c sets of torques (..., f, c).

    `J` (..., k, f): columns of the closure Jacobian for the free joints, with a row for each of k closure components.
    `E` (..., k, r): basis of the r independent wrenches that the fixture can carry (``E' N = 0``).
    `friction_m`: friction torque of a free joint per force at the fixture, N m/N.
    """
    K = np.swapaxes(E, -1, -2) @ J
    square = K @ np.swapaxes(K, -1, -2) + friction_m**2 * np.eye(K.shape[-2])
    return np.asarray(-(E @ np.linalg.solve(square, K)) @ torque)


def driven_sets(joints: int, equations: int) -> list[tuple[int, ...]]:
    """Return possible sets of joints in position mode, as indices from 0. There are at most `MOST_DRIVE_SETS` sets.

    Each set has ``joints - equations`` joints, as many as the loop has degrees of freedom.
    """
    every = list(combinations(range(joints), max(joints - equations, 0)))
    return [every[i] for i in evenly(len(every), MOST_DRIVE_SETS)]


def farthest(points: FloatArray, count: int, *, first: int | None = None) -> IntArray:
    """Return the indices of `count` of the `points` (m, d), chosen far from each other.

    The first is `first`, by default the point nearest to the mean. Each next one is farthest from those chosen so far.
    """
    if len(points) <= count:
        return np.arange(len(points))
    if first is None:
        first = int(np.argmin(((points - points.mean(axis=0)) ** 2).sum(-1)))
    chosen = [first]
    distance = ((points - points[first]) ** 2).sum(-1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(-1))
    return np.array(chosen)

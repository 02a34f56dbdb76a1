"""Makes a plan from an estimate: which poses to visit, in which order, with which drive joints.

The poses are a D-optimal choice from those that the drives can reach by safe paths, within the region where the
estimate predicts the free joints reliably.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.chain.parameters import DhEntry
from solver.closing import ClosedPoses, close_loops, reduced_equations
from solver.design.d_optimal import (
    PoseInformation,
    TooFewCandidatesError,
    choose_poses,
    pose_information,
)
from solver.design.drive_joints import RankedDrives, rank_over_region
from solver.design.manifold import Manifold, candidate_poses
from solver.design.motion import LIMITS, MotionLimits, Ranges
from solver.design.paths import PathGraph
from solver.design.stop_rule import standard_deviations
from solver.diagnostics.identifiability import Identifiability, identifiability_of_jacobian
from solver.errors import SolverError
from solver.estimators.error_model import ErrorModel
from solver.estimators.implicit import NoiseModel
from solver.estimators.variance_components import settle
from solver.loops.closure import ClosureModel, in_order

CANDIDATES = 3000
"""Number of candidate poses of a plan."""
AVOID_RADIUS_RAD = 0.15
"""Nothing is planned this near to a pose where a move had to be stopped."""
APART_RAD = 0.1
"""Smallest distance between chosen poses (Euclidean, all joints)."""
MOST_UNCERTAIN_RAD = float(np.deg2rad(3.0))
"""Largest standard deviation of a free joint's predicted angle at a planned pose."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningTask:
    """Inputs that are the same for every plan.

    `model`: the loop with all joints sensed. `candidates`: number of poses to choose from.
    `margin_rad`: least distance of planned poses and paths from the ends of the ranges, scalar or (n,).
    `noise`: noise of a pose's readings, with one variance for each joint, (n,).
    `errors_at`: function that returns the error model for readings (m, n), the same as in the final calibration.
    `toleranced`: entries of the arm's table that are corrected within their tolerances.
    `prior`: standard deviations (rad, m) of parameters before any pose, by name.
    `parameters`: names of the parameters to be determined; the others count as known. None: all.
    `drive_sets`: sets of drive joints to plan with, beginning with the set in use. None: only the best of all sets.
    `pose_leverage`: least leverage of the drives at a planned pose. It is larger than along a path, because the weight
    of the free joints must not deflect the fixture there.
    """

    model: ClosureModel
    ranges: Ranges
    margin_rad: float | FloatArray
    noise: NoiseModel
    errors_at: Callable[[FloatArray], ErrorModel]
    toleranced: tuple[DhEntry, ...] = ()
    prior: Mapping[str, float] = field(default_factory=dict)
    parameters: tuple[str, ...] | None = None
    drive_sets: tuple[tuple[int, ...], ...] | None = None
    limits: MotionLimits = LIMITS
    pose_leverage: float = 0.3
    candidates: int = CANDIDATES
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PosePlan:
    """Poses to visit, and what the next plan needs.

    `manifold`: its m poses are the candidates. `visits`: indices of the chosen candidates in visiting order.
    `information`: information of each candidate about the parameters. `graph`: paths between candidates.
    `allowed` (m,): whether a candidate can be reached, is predicted reliably, and gives the drives enough leverage.
    `ranked`: drive sets ranked over all candidates, best first; empty if `PlanningTask.drive_sets` states the sets.
    `predicted_sigma` (P,): standard deviations predicted from all captured and chosen poses; inf if undetermined.
    `design`: identifiability of the parameters from the chosen poses alone, with the paper's Jacobian.
    """

    manifold: Manifold
    information: PoseInformation
    graph: PathGraph
    allowed: BoolArray
    visits: tuple[int, ...]
    ranked: tuple[RankedDrives, ...]
    predicted_sigma: FloatArray
    design: Identifiability

    @property
    def poses_rad(self) -> FloatArray:
        """Planned poses (k, n) in visiting order: predicted readings of all joints."""
        return self.manifold.q[list(self.visits)]

    @property
    def reach_rad(self) -> FloatArray:
        """Lowest and highest reading (n, 2), rad, of each joint over all allowed candidates."""
        reachable = self.manifold.q[self.allowed]
        return np.stack((reachable.min(axis=0), reachable.max(axis=0)), axis=-1)


def make_plan(
    task: PlanningTask,
    x: FloatArray,
    q_start: FloatArray,
    count: int,
    *,
    captured: FloatArray | None = None,
    covariance: FloatArray | None = None,
    avoid_rad: Sequence[FloatArray] = (),
) -> PosePlan:
    """Plan `count` poses for an arm at the readings `q_start` (n,), with the estimate `x` (P,) of the parameters.

    Raises `ValueError` if the loop does not close near the start, or fewer than `count` poses can be reached.
    `captured`: joint angles (c, n) of poses captured already; their information is included.
    `covariance` (P, P): covariance of `x`, used to exclude poses whose prediction is uncertain; None: none is excluded.
    `avoid_rad`: readings, (n,) each, of poses to avoid, e.g. where a move had to be stopped. No pose of a visit or path
    is nearer to them than `AVOID_RADIUS_RAD`, or than half their distance from `q_start` if that is smaller.
    """
    manifold = candidate_poses(
        task.model,
        x,
        q_start,
        task.ranges.within(task.margin_rad),
        count=task.candidates,
        seed=task.seed,
    )
    ranked: tuple[RankedDrives, ...] = ()
    if (sets := task.drive_sets) is None:
        ranked = rank_over_region(manifold)
        sets = (ranked[0].drives,)
    trusted = np.ones(manifold.size, dtype=np.bool_)
    if covariance is not None:
        trusted = _trusted(task, manifold, sets, covariance)
    for pose in avoid_rad:
        # The arm must be able to leave a pose near its present one.
        radius = min(AVOID_RADIUS_RAD, 0.5 * float(np.linalg.norm(q_start - pose)))
        trusted &= ((manifold.q - pose) ** 2).sum(-1) > radius**2
    # Every path starts at the present pose.
    trusted[0] = True
    graph = PathGraph(manifold, sets, task.limits, allowed=trusted)
    allowed = graph.reachable(0)
    before = np.zeros((0, len(q_start))) if captured is None else captured
    known, information = information_of(task, x, before, manifold)
    allowed &= np.max([manifold.motion.leverage(d) for d in sets], axis=0) >= task.pose_leverage
    points = [0, *_choose(task, manifold, information, known, allowed, count)]
    visits = tuple(points[k] for k in visiting_order(graph.distances(points)))
    chosen_q = manifold.q[list(visits)]
    J = task.model.reduced(x, chosen_q).jac_x
    return PosePlan(
        manifold=manifold,
        information=information,
        graph=graph,
        allowed=allowed,
        visits=visits,
        ranked=ranked,
        predicted_sigma=standard_deviations(
            information.of(visits) + known, len(information.parameters)
        ),
        design=identifiability_of_jacobian(J, [p.name for p in task.model.parameters], chosen_q),
    )


def _choose(
    task: PlanningTask,
    manifold: Manifold,
    information: PoseInformation,
    known: FloatArray,
    allowed: BoolArray,
    count: int,
) -> tuple[int, ...]:
    choose = partial(
        choose_poses,
        information.root,
        count,
        parameters=len(information.parameters),
        fixed=known,
        allowed=allowed,
        q=manifold.q,
        seed=task.seed,
    )
    for share in (1.0, 0.5):
        with suppress(TooFewCandidatesError):
            return choose(apart_rad=share * APART_RAD)
    return choose()


def information_of(
    task: PlanningTask, x: FloatArray, readings: FloatArray, candidates: Manifold | ClosedPoses
) -> tuple[FloatArray, PoseInformation]:
    """Return the information (N, N) from priors and captured poses together, and the information of each candidate.

    `readings` (c, n): captured poses; the information of each is calculated at the nearest pose that closes the loop.
    The variances of the errors come from a fit of the captured poses or, if no fit is possible, are the start values of
    the error model.
    """
    c = len(readings)
    closed = close_loops(task.model, x, readings, sigma_rad=np.sqrt(task.noise.joint_variance))
    every_q = np.concatenate((readings, candidates.q))
    q, u = np.concatenate((closed.q, candidates.q)), np.concatenate((closed.u, candidates.u))
    model = task.model.freed(task.toleranced)
    every = in_order(model, task.model, x)
    variances = _estimated_variances(task, model, every, readings)
    information = pose_information(model, every, every_q, q, u, task.errors_at(every_q), variances)
    information = information if task.parameters is None else information.about(task.parameters)
    prior = np.zeros(information.root.shape[-1])
    for k, name in enumerate(information.parameters):
        prior[k] = task.prior.get(name, np.inf) ** -2.0
    known = information.of(range(c)) + np.diag(prior)
    return known, replace(information, root=information.root[c:])


def _estimated_variances(
    task: PlanningTask, model: ClosureModel, x: FloatArray, readings: FloatArray
) -> Mapping[str, float] | None:
    """Estimate the variances of the error model, by name, from captured readings (c, n); None if no fit is possible."""
    if not len(readings):
        return None
    errors = replace(task.errors_at(readings), prior=task.prior)
    try:
        fit = settle(model, readings, errors, x0=x)[0].fit
    except SolverError:
        return None
    return {c.name: float(v) for c, v in zip(fit.design.components, fit.v, strict=True)}


def prediction_sigma(
    A: FloatArray, B: FloatArray, covariance: FloatArray, drives: tuple[int, ...]
) -> FloatArray:
    """Largest standard deviation of a free joint's predicted angle at given drive angles, for each pose (m,), rad.

    `A` (m, r, P), `B` (m, r, n): reduced Jacobians of the poses with respect to parameters and readings. If the
    parameters change by dphi, the free joints (columns B_p of B) move by ``dq = -B_p^+ A dphi``.
    """
    free = [j for j in range(B.shape[-1]) if j + 1 not in drives]
    G = np.linalg.pinv(B[..., free]) @ A
    variance = ((G @ covariance) * G).sum(-1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)).max(-1))


def _trusted(
    task: PlanningTask,
    manifold: Manifold,
    sets: tuple[tuple[int, ...], ...],
    covariance: FloatArray,
) -> BoolArray:
    """Whether the free joints' angles at each pose (m,) are predicted reliably for at least one of the drive `sets`."""
    reduced = reduced_equations(manifold.model.loop(manifold.x, manifold.q, manifold.u))
    sigmas = [prediction_sigma(reduced.A, reduced.B, covariance, drives) for drives in sets]
    sigma = np.min(sigmas, axis=0)
    room = task.ranges.within(task.margin_rad).clearance(manifold.q)
    return np.asarray((sigma <= MOST_UNCERTAIN_RAD) & (room >= 3.0 * sigma))


FAR_RAD = 1e3
"""Replaces an infinite distance: large, but small enough that sums keep the digits of finite distances."""
MOST_SWEEPS = 50
"""Largest number of sweeps of 2-opt; more than ten are rare."""


def visiting_order(distances: FloatArray) -> tuple[int, ...]:
    """Order points 1..k-1 into a short open tour from point 0, by nearest neighbour and 2-opt.

    `distances` (k, k): symmetric; inf where there is no path.
    """
    size = len(distances)
    # The open end is a point at distance 0 from all others.
    finite = np.pad(np.where(np.isfinite(distances), distances, FAR_RAD), (0, 1))
    tour, unvisited = [0], set(range(1, size))
    while unvisited:
        tour.append(min(unvisited, key=lambda p: (float(finite[tour[-1], p]), p)))
        unvisited.remove(tour[-1])
    tour.append(size)
    for _ in range(MOST_SWEEPS):
        improved = False
        for a, b in combinations(range(1, size), 2):
            before, first, last, after = tour[a - 1], tour[a], tour[b], tour[b + 1]
            old = finite[before, first] + finite[last, after]
            if finite[before, last] + finite[first, after] < old - 1e-9:
                tour[a : b + 1] = reversed(tour[a : b + 1])
                improved = True
        if not improved:
            break
    return tuple(tour[1:-1])

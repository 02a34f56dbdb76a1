"""Minimises from all starts of a global start in one batch, by damped Gauss-Newton iteration.

Every start has its own damping; starts that have converged leave the batch. `global_start` refines the results.

If the fixture is passive, the search varies only the offsets of the inner joints, 2 .. n-1. The fixture's unknowns are
projected out: they follow from these offsets, because the part of the tool that the fixture constrains (a line, a point
or the whole tool) does not move in the base frame. With M_i = R_1 .. R_{n-1} Rz(theta_n) and p_i the origin of frame
n-1 at pose i,

    hinge:  M_i h = const,      p_i + M_i t = const      (h: direction of the line in the tool; t: a point on it)
    ball:                       p_i + M_i t = const      (t: the ball's centre)
    rigid:  M_i   = const,      p_i = const

For given offsets, h, t and the constants follow in closed form: h is the dominant right singular vector of the mean of
M_i, t solves linear equations, the constants are means. So a hinge problem with 14 unknowns is a search over 5 angles
(variable projection, Golub & Pereyra, with Kaufman's Jacobian), without any guess about the fixture. The direction of
the line is common to all poses, so a pose with the tool upside down (on the flipped branch) never counts as closed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable, Frames, forward
from solver.chain.parameters import DhKind, nominal_vector, wrap_angle
from solver.estimators.least_squares import Progress
from solver.estimators.load_effects import farthest
from solver.loops.closure import ClosureModel, ConstrainedPart, Which
from solver.loops.endpoint_geometry import Line

HALT_AFTER = 8
SURVIVING_SHARE, FEWEST_SURVIVORS = 1.0 / 3.0, 30
"""After `HALT_AFTER` iterations only the best third of the starts continues. This third includes 80 to 100 % of the
starts that would have reached the solution (random hinges, a ball), and the work saved allows twice as many starts."""

SEARCH_EQUATIONS = 72
"""Number of closure equations that the search uses: a few times the number of unknowns of any usual arm."""

REFINED_MINIMA = 6
"""Number of minima that are refined. Few are enough, because the cost of the true minimum is orders of magnitude below
the cost of any other."""

SAME_MINIMUM = 0.02
"""Starts that end within this distance of each other (rad) count as one minimum."""


BatchProblem = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function from K unknowns of S starts, (S, K), to R residuals of each start, (S, R), and their Jacobian (S, R, K)."""

FIRST_DAMPING = 1e-2
EASIER, HARDER = 0.2, 5.0
STUCK_DAMPING = 1e7
STEP_TOLERANCE = 1e-7

BATCH_ITERATIONS, LONGEST_STEP_RAD = 40, 0.7
"""Largest number of iterations, and largest component of a step: in larger steps a linearised rotation is invalid."""


def best_minima(
    model: ClosureModel,
    q: FloatArray,
    starts: int,
    rng: np.random.Generator,
    progress: Progress | None,
) -> list[tuple[FloatArray, int]]:
    """Minimise from all starts; return the best minima: parameters (P,), and how many starts led to each."""
    parameters, parts = model.parameters, projectable_parts(model, q)
    if parts and parts[0].searched:
        # The placement with the most poses determines the arm's offsets; the others determine only their fixtures.
        largest = max(parts, key=lambda part: len(part.q))
        count = -(-SEARCH_EQUATIONS // model.equations_per_pose)
        problem: BatchProblem = replace(largest, q=spread_poses(largest.q, count))
        nominal = np.array([largest.table.theta_off_rad[j - 1] for j in largest.searched])
        guessed = angles = list(range(len(nominal)))
    else:
        parts, problem = [], partial(_all_equations, model, q)
        nominal = nominal_vector(parameters)
        guessed = [k for k, p in enumerate(parameters) if p.name.startswith("theta_off_")]
        angles = [k for k, p in enumerate(parameters) if p.is_angle]
    x0 = np.tile(nominal, (starts, 1))
    x0[1:, guessed] = rng.uniform(-np.pi, np.pi, (starts - 1, len(guessed)))
    minima = []
    for unknowns, starts_there in _minima(*_minimised(problem, x0, progress), angles=angles):
        x = nominal_vector(parameters) if parts else unknowns
        for part in parts:
            x[part.columns] = part.filled(unknowns)
        minima.append((x, starts_there))
    return minima


def _all_equations(
    model: ClosureModel, q: FloatArray, x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the closure errors of all poses (S, R), and their Jacobian (S, R, P), at parameters `x` (S, P)."""
    error, count = model.reduced(x, q), len(x)
    return error.residual.reshape(count, -1), error.jac_x.reshape(count, -1, x.shape[1])


def _minima(
    x: FloatArray, cost: FloatArray, *, angles: Sequence[int]
) -> list[tuple[FloatArray, int]]:
    """Return the best minima in order of increasing cost, with the number of starts that reached each.

    `x` (S, K), `cost` (S,): results of S starts. Two results are the same minimum if the columns `angles` of `x` agree.
    """
    order = np.argsort(cost, kind="stable")
    minima: list[tuple[FloatArray, int]] = []
    while len(order) and len(minima) < REFINED_MINIMA:
        apart = wrap_angle(x[order][:, angles] - x[order[0], angles])
        same = np.abs(apart).max(-1, initial=0.0) < SAME_MINIMUM
        minima.append((x[order[0]], int(same.sum())))
        order = order[~same]
    return minima


def _minimised(
    problem: BatchProblem, x0: FloatArray, progress: Progress | None
) -> tuple[FloatArray, FloatArray]:
    """Minimise the sum of squares, from each row of `x0` (S, K); return the final unknowns (S, K) and sums (S,)."""
    survivors = max(FEWEST_SURVIVORS, int(SURVIVING_SHARE * len(x0)))
    x = np.array(x0, dtype=np.float64)
    r, J = problem(x)
    cost = np.einsum("sr,sr->s", r, r)
    damping = np.full(len(x), FIRST_DAMPING)
    active = np.arange(len(x))
    for iteration in range(1, BATCH_ITERATIONS + 1):
        Jt = np.swapaxes(J, -1, -2)
        N, gradient = Jt @ J, (Jt @ r[..., None])[..., 0]
        diagonal = np.diagonal(N, axis1=-2, axis2=-1)
        # Marquardt's scaling; a column of zeros needs a divisor too.
        tiny = 1e-12 * diagonal.max(-1, keepdims=True) + 1e-300
        N = N + (damping[active, None] * diagonal + tiny)[..., None] * np.eye(x.shape[1])
        step = -np.linalg.solve(N, gradient[..., None])[..., 0]
        longest = np.abs(step).max(-1)
        step *= np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(longest, 1e-300))[:, None]
        trial = x[active] + step
        r_new, J_new = problem(trial)
        cost_new = np.einsum("sr,sr->s", r_new, r_new)
        better = cost_new < cost[active]
        x[active[better]], cost[active[better]] = trial[better], cost_new[better]
        r = np.where(better[:, None], r_new, r)
        J = np.where(better[:, None, None], J_new, J)
        damping[active] *= np.where(better, EASIER, HARDER)
        if progress is not None:
            progress(iteration, float(cost.min()))
        going = (longest > STEP_TOLERANCE) & (damping[active] < STUCK_DAMPING)
        if iteration == HALT_AFTER:
            going &= np.isin(active, np.argsort(cost, kind="stable")[:survivors])
        active, r, J = active[going], r[going], J[going]
        if not len(active):
            break
    return x, cost


RIDGE = 1e-9
"""Added to the diagonal of normal equations, which are singular if t may be any point of a line; affects no result."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InnerProblem:
    """The `BatchProblem` of one placement, whose unknowns are offsets of inner joints.

    `model`: loop of the placement. `columns`: indices of the loop's parameters in the whole parameter vector.
    `table`: D-H rows 1..n. Values that the fixture's unknowns replace are zero: theta_off_1, s_1 and all of row n.
    `searched`: joints (1-based, never 1 or n) whose offsets are the unknowns. Other offsets are those of `table`.
    `q`: joint angles (m, n), rad. `per_m`: weight of positions relative to directions, 1/m.
    """

    model: ClosureModel
    columns: Which
    table: DhTable
    searched: tuple[int, ...]
    q: FloatArray
    per_m: float

    def __call__(self, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return R residuals (S, R) and Jacobian (S, R, K) for S rows of K offsets, without the fixture's unknowns."""
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
        """Return the loop's parameters (P,): `offsets` (K,), rad, and best-fitting values of the fixture's unknowns."""
        frames = self._frames(offsets[None, :])
        M, p = frames.R_end, frames.p_end
        mean = M.mean(-3, keepdims=True)
        h, t = self._projected(M, M - mean, p)
        along = mean[0, 0] @ h[0]
        point = (p + (M @ t[:, None, :, None])[..., 0]).mean(-2)[0]
        ground = Line(point_m=point, direction=along / np.linalg.norm(along))
        hand = Line(point_m=t[0], direction=h[0])
        values = {
            f"theta_off_{j}": float(wrap_angle(v))
            for j, v in zip(self.searched, offsets, strict=True)
        }
        values |= self.model.constraint_entries(ground, hand, mean[0, 0])
        return nominal_vector(self.model.parameters, values)

    def _frames(self, offsets: FloatArray) -> Frames:
        theta = np.broadcast_to(self.q, (len(offsets), *self.q.shape)) + self.table.theta_off_rad
        for k, joint in enumerate(self.searched):
            theta[..., joint - 1] = offsets[:, None, k] + self.q[:, joint - 1]
        return forward(theta, *self.table.stacked()[1:])

    def _projected(
        self, M: FloatArray, M_c: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the best-fitting h and t of the module's equations, (S, 3) each, for S starts.

        A rigid fixture has neither: the result is then the z axis and 0. `M` (S, m, 3, 3), `p` (S, m, 3): M_i and p_i
        at m poses. `M_c`: M minus its mean over the poses.
        """
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
    """Return two unit vectors perpendicular to each unit vector `h` (S, 3) and to each other, as columns (S, 3, 2)."""
    first = np.cross(h, np.eye(3)[np.argmin(np.abs(h), axis=-1)])
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack((first, np.cross(h, first)), axis=-1)


def spread_poses(q: FloatArray, count: int) -> FloatArray:
    """Return `count` of the poses `q` (m, n), chosen far from each other; the choice does not depend on their order.

    Farthest-point selection over the points (cos q, sin q); the first is the pose farthest from the mean.
    """
    points = np.concatenate((np.cos(q), np.sin(q)), axis=-1)
    points -= points.mean(0)
    return q[farthest(points, count, first=int(np.argmax((points**2).sum(-1))))]


def projectable_parts(model: ClosureModel, q: FloatArray) -> list[InnerProblem]:
    """Return an `InnerProblem` for each placement; an empty list if the fixture does not constrain the tool."""
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

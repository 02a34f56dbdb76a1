"""Quality of the captured poses, from the paper's fast estimator, and prediction of planned poses.

The estimates are not exported. A prediction from nominal geometry has the errors of that geometry.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from operator_app.planning.exploration import RANGE_END_MARGIN_RAD
from operator_app.planning.task import ranges_of
from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.design.d_optimal import choose_poses
from solver.design.motion import LIMITS, drive_straight
from solver.design.paths import LINE_STEP_RAD
from solver.design.plan import PlanningTask, information_of
from solver.diagnostics.identifiability import identifiability
from solver.estimators.estimate import closure_at_readings
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel, poses_needed
from solver.loops.endpoints import MeasuredClosure

EACH_UP_TO = 100
"""Up to this number of poses, the parameters are estimated after each pose."""
GROWTH = 1.02
"""With many poses, the parameters are estimated again whenever the number of poses has grown by this factor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveQuality:
    """Quality of a growing set of poses.

    `numbers`: numbers of the poses. `needed`: smallest number of poses from which parameters can be estimated.
    `x` (P,): latest estimate, rad or m; nominal values before the first estimate.
    `estimated`: whether the latest estimate converged and the poses determined all parameters.
    `scaled_condition_number`, `weakest`: at the latest estimate, scaled condition number and the parameters that the
    poses determined least; inf and () before the first estimate.
    `history`: number of poses and scaled condition number at each estimate, oldest first.
    `coverage`: lowest and highest captured angle of each joint, rad; empty without poses.
    `predicted_m`: by pose number, the pose's position closure error, m, for the last estimate made before this pose.
    """

    needed: int
    x: FloatArray
    estimated: bool = False
    scaled_condition_number: float = float("inf")
    weakest: tuple[str, ...] = ()
    history: tuple[tuple[int, float], ...] = ()
    coverage: tuple[tuple[float, float], ...] = ()
    predicted_m: Mapping[int, float] = field(default_factory=dict)
    numbers: tuple[int, ...] = ()


def live_quality(
    arm: ArmModel,
    model: ClosureModel,
    q_rad: FloatArray,
    numbers: tuple[int, ...],
    *,
    earlier: LiveQuality | None = None,
) -> LiveQuality:
    """Return the quality of the poses `q_rad` (m, n); continues from `earlier` if this is that of the first poses."""
    if earlier is not None and earlier.numbers == numbers[: len(earlier.numbers)]:
        quality = earlier
    else:
        quality = LiveQuality(
            needed=poses_needed(len(model.parameters), model.equations_per_pose),
            x=nominal_vector(model.parameters),
            predicted_m={} if earlier is None else earlier.predicted_m,
        )
    shared = len(quality.numbers)
    for count in range(shared + 1, len(numbers) + 1):
        # If many poses are added at once, as after a resume, the parameters are estimated after the last pose.
        last_of_many = count == len(numbers) > shared + 1
        quality = _with_one_more(
            arm, model, q_rad[:count], numbers[:count], quality, at_once=last_of_many
        )
    return quality


def _with_one_more(
    arm: ArmModel,
    model: ClosureModel,
    q: FloatArray,
    numbers: tuple[int, ...],
    before: LiveQuality,
    *,
    at_once: bool,
) -> LiveQuality:
    number, predicted = numbers[-1], dict(before.predicted_m)
    if before.estimated and number not in predicted:
        error = closure_at_readings(model.at_poses(np.array([len(q) - 1])), before.x, q[-1:])
        predicted[number] = float(np.linalg.norm(error.residual[0, error.rotation_rows :]))
    quality = replace(
        before,
        numbers=numbers,
        coverage=tuple(zip(q.min(axis=0).tolist(), q.max(axis=0).tolist(), strict=True)),
        predicted_m=predicted,
    )
    estimated = before.history[-1][0] if before.history else 0
    due = len(q) <= EACH_UP_TO or len(q) >= GROWTH * estimated
    if len(q) < before.needed or not (due or at_once):
        return quality
    model = model.at_poses(np.arange(len(q)))
    # The fit starts at the nominal values, not at the last estimate: an early estimate may be inaccurate.
    estimate = estimate_paper(model, q)
    identified = identifiability(model, estimate.x, q, sigma_rad=arm.sigma_rad())
    return replace(
        quality,
        x=estimate.x,
        estimated=estimate.converged and not identified.directions,
        scaled_condition_number=identified.scaled_condition_number,
        weakest=identified.weakest.parameters,
        history=(*before.history, (len(q), identified.scaled_condition_number)),
    )


STEPS = 24
"""Number of steps in which a move to a waypoint is predicted: small steps keep the loop on its branch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """Predicted poses of a plan.

    `q_rad` (w, n): joint angles at each waypoint, or as far on the way to it as the chain can be followed.
    `reachable` (w,): whether, at each waypoint, the loop closes with every joint inside its range.
    `scaled_condition_number`: of the first reachable poses, as many as planned; inf if a parameter is undetermined.
    """

    q_rad: FloatArray
    reachable: BoolArray
    scaled_condition_number: float

    @property
    def reaches_nothing(self) -> bool:
        """Whether all poses are unreachable, usually because of wrong joint readings."""
        return not bool(self.reachable.any())

    def span_rad(self, joint: int, poses: int) -> tuple[float, float]:
        """Return the lowest and highest angle of a joint (1-based) over the first `poses` reachable poses.

        Raises `ValueError` if no pose can be reached.
        """
        column = self.q_rad[self.reachable][:poses, joint - 1]
        return float(column.min()), float(column.max())


def predict(
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    *,
    start_rad: FloatArray,
    plan: Sequence[Mapping[int, float]],
    poses: int,
) -> Forecast:
    """Predict the poses at the waypoints `plan` (rad, by drive joint) for an arm that starts at `start_rad` (n,).

    `poses`: number of poses to capture. `Forecast.scaled_condition_number` is for this number of reachable poses.
    """
    joints = tuple(plan[0])
    goal = np.array([[point[j] for j in joints] for point in plan])
    if isinstance(model, MeasuredClosure):
        q = np.repeat(np.asarray(start_rad)[None, :], len(plan), axis=0)
        q[:, [j - 1 for j in joints]], closed = goal, np.ones(len(plan), dtype=np.bool_)
    else:
        start = close_loops(model, x, np.asarray(start_rad)[None, :])
        q, u = (np.repeat(angles, len(plan), axis=0) for angles in (start.q, start.u))
        moves = drive_straight(model, x, q, u, joints, goal, steps=STEPS)
        q, closed = moves.q[:, -1], moves.closed
    reachable = closed & np.all((q > arm.lower_rad) & (q < arm.upper_rad), axis=1)
    chosen = q[reachable][:poses]
    condition = float("inf")
    if len(chosen) * model.equations_per_pose > len(model.parameters):
        loop = model
        if isinstance(model, MeasuredClosure):
            position, rotation = model.predicted(x, chosen)
            loop = model.with_endpoints(position, rotation if model.full_pose else None)
        condition = identifiability(loop, x, chosen).scaled_condition_number
    return Forecast(q_rad=q, reachable=reachable, scaled_condition_number=condition)


def most_informative(
    task: PlanningTask,
    x: FloatArray,
    *,
    taken_rad: FloatArray,
    forecast: Forecast,
    open_waypoints: Sequence[int],
) -> int | None:
    """Return which of `open_waypoints` (indices) would add the most information to the poses `taken_rad` (m, n).

    The result is None if `taken_rad` is empty or, according to `forecast`, no open waypoint is reachable.
    """
    candidates = [k for k in open_waypoints if forecast.reachable[k]]
    if not candidates or not len(taken_rad):
        return None
    closed = close_loops(task.model, x, forecast.q_rad[candidates])
    known, offered = information_of(task, x, taken_rad, closed)
    (best,) = choose_poses(offered.root, 1, parameters=len(offered.parameters), fixed=known)
    return candidates[best]


def is_path_clear(
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    here_rad: FloatArray,
    targets_rad: Mapping[int, float],
) -> bool:
    """Whether a straight move of the drives to `targets_rad` avoids singularities and the ends of the ranges.

    `model`, `x`: a closed loop and its calibrated parameters (P,). `here_rad`: current angles of all joints (n,).
    """
    drives = tuple(targets_rad)
    start = close_loops(model, x, here_rad[None, :])
    goal = np.array([list(targets_rad.values())])
    way = float(np.abs(goal - here_rad[[j - 1 for j in drives]]).max())
    traces = drive_straight(
        model, x, start.q, start.u, drives, goal, steps=max(1, int(np.ceil(way / LINE_STEP_RAD)))
    )
    safe = traces.safe(ranges_of(arm).within(RANGE_END_MARGIN_RAD), LIMITS)
    return bool(start.closed[0] and safe[0])

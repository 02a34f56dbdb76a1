"""Prediction of a plan by the present model: joint angles, range limits, condition number, clear straight paths.

With nominal geometry the prediction has the errors of that geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from operator_app.planning.task import STOP_MARGIN_RAD, ranges_of
from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.closing import close_loops
from solver.design.drive_line import drive_straight
from solver.design.paths import LINE_STEP_RAD, MotionLimits
from solver.design.pose_information import planning_noise, pose_information
from solver.diagnostics.identifiability import identifiability
from solver.loops.closure import ClosureModel
from solver.loops.open_arm import MeasuredClosure

LEGS = 24
"""Number of steps to each waypoint, so that no loop jumps to another branch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """Predicted poses of a plan.

    Attributes
    ----------
    q_rad
        (w, n): joint angles at every waypoint.
    reachable
        (w,) bool: the loop closes there and every joint is inside its range.
    scaled_condition_number
        Of the first wanted poses of the plan; inf if they do not determine all parameters.
    """

    q_rad: FloatArray
    reachable: BoolArray
    scaled_condition_number: float

    @property
    def reaches_nothing(self) -> bool:
        """Whether no pose can be reached: usually because of wrong joint readings."""
        return not bool(self.reachable.any())

    def span_rad(self, joint: int, poses: int) -> tuple[float, float]:
        """Lowest and highest angle of a joint (1-based) over the first reachable `poses`.

        ValueError where it `reaches_nothing`.
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
    """Follow the closed chain from `start_rad` (n,) to every waypoint of `plan`."""
    joints = tuple(plan[0])
    columns = [j - 1 for j in joints]
    if isinstance(model, MeasuredClosure):
        goals = np.repeat(np.asarray(start_rad)[None, :], len(plan), axis=0)
        goals[:, columns] = [[point[j] for j in joints] for point in plan]
        return _of_open_arm(arm, model, x, goals, poses)
    weight = np.ones(arm.joint_count)
    here = close_loops(model, x, np.asarray(start_rad)[None, :])
    # The drive joints are given; the other joints follow.
    weight[columns] = 0.0
    goal = np.array([[point[j] for j in joints] for point in plan])
    q = np.repeat(here.q, len(plan), axis=0)
    u = np.repeat(here.u, len(plan), axis=0)
    begin, closed = q[:, columns].copy(), np.ones(len(plan), dtype=np.bool_)
    for leg in np.linspace(0.0, 1.0, LEGS + 1)[1:]:
        q[:, columns] = begin + leg * (goal - begin)
        step = close_loops(model, x, q, sigma_rad=weight, u=u, max_iterations=8, tolerance=1e-6)
        q, u = step.q, step.u
        closed = np.abs(model.loop(x, q, u).residual).max(axis=-1) < 1e-4
    inside = np.all((q > arm.lower_rad) & (q < arm.upper_rad), axis=1)
    reachable = closed & inside
    chosen = q[reachable][:poses]
    condition = float("inf")
    if len(chosen) * model.equations_per_pose > len(model.parameters):
        condition = identifiability(model, x, chosen).scaled_condition_number
    return Forecast(q_rad=q, reachable=reachable, scaled_condition_number=condition)


def _of_open_arm(
    arm: ArmModel, model: MeasuredClosure, x: FloatArray, q: FloatArray, poses: int
) -> Forecast:
    """Return the forecast of an open arm at these angles (w, n)."""
    inside = np.all((q > arm.lower_rad) & (q < arm.upper_rad), axis=1)
    chosen = q[inside][:poses]
    condition = float("inf")
    if len(chosen) * model.equations_per_pose > len(model.parameters):
        position, rotation = model.predicted(x, chosen)
        seen = model.with_endpoints(position, rotation if model.full_pose else None)
        condition = identifiability(seen, x, chosen).scaled_condition_number
    return Forecast(q_rad=q, reachable=inside, scaled_condition_number=condition)


def most_informative(
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    *,
    taken_rad: FloatArray,
    forecast: Forecast,
    open_waypoints: Sequence[int],
) -> int | None:
    """Return the waypoint whose pose adds most information to the captured ones (m, n) (D-optimality)."""
    candidates = [k for k in open_waypoints if forecast.reachable[k]]
    if not candidates or not len(taken_rad):
        return None
    sigma = np.maximum(arm.sigma_rad(), 1e-6)
    noise = planning_noise(sigma, unsensed_joints=model.unsensed_joints)
    everything = np.concatenate((taken_rad, forecast.q_rad[candidates]))
    closed = close_loops(model, x, everything, sigma_rad=sigma)
    information = pose_information(model, x, closed.q, closed.u, noise)
    known = information.of(range(len(taken_rad)))
    scale = np.sqrt(np.maximum(np.diagonal(information.of(range(len(everything)))), 1e-300))
    # A small prior in every direction, so that the first poses can be compared too.
    known = known / np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
    root = information.root[len(taken_rad) :] / scale
    gain = root @ np.linalg.solve(known, np.swapaxes(root, -1, -2))
    value = np.linalg.slogdet(np.eye(gain.shape[-1]) + gain)[1]
    return candidates[int(np.argmax(value))]


def is_path_clear(
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    here_rad: FloatArray,
    targets_rad: Mapping[int, float],
) -> bool:
    """Whether a straight move of the drives to `targets_rad` avoids folds and the ends of ranges.

    Parameters
    ----------
    model, x
        A closed loop and its calibrated parameters (P,).
    here_rad
        Present angles of all joints (n,).
    """
    limits, drives = MotionLimits(), tuple(targets_rad)
    start = close_loops(model, x, here_rad[None, :])
    goal = np.array([list(targets_rad.values())])
    way = float(np.abs(goal - here_rad[[j - 1 for j in drives]]).max())
    traces = drive_straight(
        model, x, start.q, start.u, drives, goal, steps=max(1, int(np.ceil(way / LINE_STEP_RAD)))
    )
    safe = traces.safe(
        ranges_of(arm).within(STOP_MARGIN_RAD),
        least_leverage=limits.least_leverage,
        most_rate=limits.most_rate,
    )
    return bool(start.closed[0] and safe[0])

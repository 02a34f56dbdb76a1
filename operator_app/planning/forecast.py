"""Where a plan will take every joint, by the model at hand: predicted poses, ranges, condition number.

A forecast from the nominal geometry is off by as much as that is; it says where joints come near
their ends and which pose would tell most, nothing exact. Knows no arm and no journal.
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
"""All waypoints are approached together in this many steps, so that no loop jumps to another branch."""


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
        Of the first poses of the plan, as many as are wanted; inf when they leave something unseen.
    """

    q_rad: FloatArray
    reachable: BoolArray
    scaled_condition_number: float

    @property
    def reaches_nothing(self) -> bool:
        """Whether no pose can be reached: the arm does not stand where its readings have it, most often."""
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
    """Follow the closed chain from where it stands (n,) to every waypoint of `plan`."""
    joints = tuple(plan[0])
    columns = [j - 1 for j in joints]
    if isinstance(model, MeasuredClosure):
        goals = np.repeat(np.asarray(start_rad)[None, :], len(plan), axis=0)
        goals[:, columns] = [[point[j] for j in joints] for point in plan]
        return _of_open_arm(arm, model, x, goals, poses)
    weight = np.ones(arm.joint_count)
    here = close_loops(model, x, np.asarray(start_rad)[None, :])
    # The drive joints are given; everything else follows.
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
    """Forecast of an arm that goes where its drives take it (w, n), seen as the model has it."""
    inside = np.all((q > arm.lower_rad) & (q < arm.upper_rad), axis=1)
    chosen = q[inside][:poses]
    condition = float("inf")
    if len(chosen) * model.equations_per_pose > len(model.parameters):
        position, rotation = model.predicted(x, chosen)
        seen = model.with_endpoints(position, rotation if model.full_pose else None)
        condition = identifiability(seen, x, chosen).scaled_condition_number
    return Forecast(q_rad=q, reachable=inside, scaled_condition_number=condition)


def most_telling(
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    *,
    taken_rad: FloatArray,
    forecast: Forecast,
    open_waypoints: Sequence[int],
) -> int | None:
    """Waypoint whose pose would add most to what the poses taken (m, n) tell (D-optimality)."""
    candidates = [k for k in open_waypoints if forecast.reachable[k]]
    if not candidates or not len(taken_rad):
        return None
    sigma = np.maximum(arm.sigma_rad(), 1e-6)
    noise = planning_noise(sigma, unsensed_joints=model.unsensed_joints)
    everything = np.concatenate((taken_rad, forecast.q_rad[candidates]))
    closed = close_loops(model, x, everything, sigma_rad=sigma)
    told = pose_information(model, x, closed.q, closed.u, noise)
    known = told.of(range(len(taken_rad)))
    scale = np.sqrt(np.maximum(np.diagonal(told.of(range(len(everything)))), 1e-300))
    # A little is known beforehand of every direction, so that the first poses can be compared too.
    known = known / np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
    root = told.root[len(taken_rad) :] / scale
    gain = root @ np.linalg.solve(known, np.swapaxes(root, -1, -2))
    value = np.linalg.slogdet(np.eye(gain.shape[-1]) + gain)[1]
    return candidates[int(np.argmax(value))]


def is_clear(
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    here_rad: FloatArray,
    targets_rad: Mapping[int, float],
) -> bool:
    """Whether drives that go straight to `targets_rad` keep away from folds and from the ends of ranges.

    Parameters
    ----------
    model, x
        A closed loop and its parameters (P,), as calibrated.
    here_rad
        Where all joints stand (n,).
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

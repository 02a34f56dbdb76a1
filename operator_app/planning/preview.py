"""Preview of a plan (drive joints, poses, paths, predicted precision), from the same planner as in captures."""

from dataclasses import dataclass, replace

import numpy as np

from fixtures.base import EndpointConstraint, SetupCheck
from fixtures.setup_checks import setup_checks
from operator_app.errors import SessionError
from operator_app.planning.drives import DriveChoice, best_or_named_drives, predict_drives
from operator_app.planning.exploration import RANGE_END_MARGIN_RAD
from operator_app.planning.task import planning_task
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import Parameter, nominal_vector
from solver.design.interim import InterimEstimate, implicit_interim
from solver.design.paths import Leg
from solver.design.plan import PlanningTask, PosePlan, make_plan
from solver.diagnostics.identifiability import Identifiability, identifiability
from solver.loops.closure import in_order


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedPose:
    """One pose of a plan.

    `q_rad` (n,): predicted readings of all joints. `drives`: drive joints (1-based). `route`: safe path to this pose,
    or None if there is none. It begins at the last pose before this one that has a path, or else at the start.
    """

    q_rad: FloatArray
    drives: tuple[int, ...]
    route: tuple[Leg, ...] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Preview:
    """A plan and the data on which it is based.

    `estimate`: estimate with which the plan was made; None if it was made with nominal values. `checks`: checks of the
    fixture at the start position. `identifiability`: identifiability from the captured and planned poses together.
    """

    arm: ArmModel
    estimate: InterimEstimate | None
    captured: int
    checks: tuple[SetupCheck, ...]
    identifiability: Identifiability
    choice: DriveChoice
    plan: PosePlan
    poses: tuple[PlannedPose, ...]

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Unknowns of the loop by name, including the offsets of unsensed joints, which count as known in the plan."""
        return {p.name: p for p in self.plan.manifold.model.parameters}

    @property
    def predicted_sigma(self) -> tuple[tuple[Parameter, float], ...]:
        """Parameters to be determined, with their predicted standard deviations, rad or m."""
        known, sigma = self.parameters, self.plan.predicted_sigma.tolist()
        names = self.plan.information.parameters
        return tuple((known[name], s) for name, s in zip(names, sigma, strict=True))


def preview(
    arm: ArmModel,
    fixture: EndpointConstraint,
    *,
    poses: int,
    position_joints: tuple[int, ...] | None = None,
    unsensed_joints: tuple[int, ...] = (),
    samples: int = 1,
    seed: int = 0,
    known_rad: FloatArray | None = None,
) -> Preview:
    """Plan `poses` poses, starting at the last captured pose in `known_rad` (m, n) or, if that is None, at home.

    Raises `SessionError` if no plan can be made, `SolverError` if the captured poses are too few for an estimate.
    """
    task = planning_task(arm, fixture, unsensed_joints=unsensed_joints, samples=samples, seed=seed)
    x, start, estimate = nominal_vector(task.model.parameters), arm.home_rad, None
    if known_rad is not None:
        start = known_rad[-1]
        estimate = implicit_interim(task.model, task.noise)(known_rad)
        if not estimate.trusted:
            raise SessionError(
                f"the captured poses give no reliable estimate for a plan ({estimate.text})",
                "capture more poses, or plan from nominal geometry: leave --session out",
            )
        x = estimate.x
    prediction = predict_drives(arm, task.model, x, start, seed=seed)
    choice = best_or_named_drives(
        prediction, position_joints, kind=fixture.kind, unsensed_joints=unsensed_joints
    )
    task = replace(task, drive_sets=choice.sets)
    try:
        plan = make_plan(
            task,
            x,
            start,
            poses,
            captured=known_rad,
            covariance=None if estimate is None else estimate.covariance,
        )
    except ValueError as error:
        raise SessionError(
            f"no plan can be made: {error}",
            "request fewer poses, name other drive joints, or mount the hinge elsewhere "
            "(`sarcal plan --advise`)",
        ) from error
    return Preview(
        arm=arm,
        estimate=estimate,
        captured=0 if known_rad is None else len(known_rad),
        checks=setup_checks(fixture, arm, start, in_order(fixture.model(arm), task.model, x)),
        identifiability=plan.design
        if known_rad is None
        else identifiability(task.model, x, np.concatenate((known_rad, plan.poses_rad))),
        choice=choice,
        plan=plan,
        poses=_visited(task, plan, choice.drives),
    )


def _visited(
    task: PlanningTask, plan: PosePlan, drives: tuple[int, ...]
) -> tuple[PlannedPose, ...]:
    poses, position = [], 0
    for target in plan.visits:
        route = plan.graph.route(
            task.ranges.within(RANGE_END_MARGIN_RAD), source=position, target=target, drives=drives
        )
        if route is not None:
            position = target
            drives = route[-1].drives if route else drives
        poses.append(PlannedPose(q_rad=plan.manifold.q[target], drives=drives, route=route))
    return tuple(poses)

"""Quality of the captured poses, and prediction of the poses still to be captured."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fixtures.base import EndpointConstraint
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.instrument_registration import with_registered_instrument
from operator_app.planning.live import (
    Forecast,
    LiveQuality,
    live_quality,
    most_informative,
    predict,
)
from operator_app.planning.task import planning_task
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.session import Session
from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.design.plan import PlanningTask
from solver.loops.closure import ClosureModel, poses_needed


class PoseQuality:
    """Evaluates the poses of a session; reuses earlier results.

    `live`: quality of the used poses. `next_waypoint`, `best_waypoint`: index of the first unvisited waypoint of the
    plan and of the most informative one. All are None if there is none or, for the last, if it is not known.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.plan: tuple[Mapping[int, float], ...] = ()
        self.forecast: Forecast | None = None
        self._task: PlanningTask | None = None
        self._placed: EndpointConstraint | None = None
        self.live: LiveQuality | None = None
        self.next_waypoint: int | None = None
        self.best_waypoint: int | None = None

    def set_plan(self, plan: tuple[Mapping[int, float], ...], start_rad: FloatArray) -> None:
        """Set the plan: waypoints (rad, by joint) of a path from `start_rad` (n,). Predict its poses."""
        session, model = self._session, self._nominal_loop
        self.plan = plan
        self.forecast = predict(
            session.model,
            model,
            nominal_vector(model.parameters),
            start_rad=start_rad,
            plan=plan,
            poses=session.procedure.capture.poses,
        )
        if session.fixture.holds_hand:
            self._task = planning_task(
                session.model,
                session.fixture,
                drive_sets=None,
                unsensed_joints=session.procedure.unsensed_joints,
                samples=session.procedure.capture.samples_per_pose,
            )

    def evaluate(self, state: SessionState) -> None:
        """Update the attributes for the poses of `state`."""
        session, used = self._session, state.used_poses
        if not used:
            self.live = self._placed = None
        else:
            q_rad = np.array([p.mean_rad for p in used])
            numbers = tuple(p.number for p in used)
            loop = self._loop_of(state)
            self.live = live_quality(session.model, loop, q_rad, numbers, earlier=self.live)
        unvisited = [k for k in range(len(self.plan)) if k not in state.visited]
        self.next_waypoint = unvisited[0] if unvisited else None
        self.best_waypoint = self._most_informative_waypoint(state, unvisited)

    def _most_informative_waypoint(self, state: SessionState, unvisited: list[int]) -> int | None:
        if self.live is None or self.forecast is None or self._task is None:
            return None
        names = [p.name for p in self._nominal_loop.parameters]
        return most_informative(
            self._task,
            self.live.x[[names.index(p.name) for p in self._task.model.parameters]],
            taken_rad=np.array([p.mean_rad for p in state.used_poses]),
            forecast=self.forecast,
            open_waypoints=unvisited,
        )

    def _loop_of(self, state: SessionState) -> ClosureModel:
        """Return the loop of the used poses; an open arm's instrument is registered once there are enough poses."""
        session, model = self._session, self._nominal_loop
        if session.fixture.holds_hand:
            return model
        poses = state.pose_set()
        needed = poses_needed(len(model.parameters), model.equations_per_pose)
        if self._placed is None and len(poses) >= needed:
            self._placed = with_registered_instrument(session.model, session.fixture, poses)
        fixture = self._placed or session.fixture
        return Experiment(arm=session.model, fixture=fixture, poses=poses).loop()

    @property
    def _nominal_loop(self) -> ClosureModel:
        return self._session.fixture.model(self._session.model)

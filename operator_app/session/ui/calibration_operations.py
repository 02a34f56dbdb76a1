"""Operations of steps 5 to 7: calibrate, compare, write, upload, verify; quality of the poses.

They run in the worker thread and may block.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from fixtures.base import EndpointConstraint
from hardware.arm import DriveState
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.instrument_registration import with_registered_instrument
from operator_app.calibration.result import Solution
from operator_app.config.parameters_file import ParametersDocument, parse_parameters
from operator_app.errors import GuardError
from operator_app.planning.live import (
    Forecast,
    LiveQuality,
    live_quality,
    most_informative,
    predict,
)
from operator_app.planning.task import planning_task
from operator_app.session.store.solver_process import SolvingProcess
from operator_app.session.store.state import SessionState
from operator_app.session.ui.snapshot import DiffRow, Level
from operator_app.session.workflow.capture import verify
from operator_app.session.workflow.export import export, recorded_export
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from operator_app.units import SIGMA_POS
from solver.arrays import FloatArray
from solver.chain.parameters import DhEntry, nominal_vector
from solver.design.plan import PlanningTask
from solver.loops.closure import ClosureModel, poses_needed

if TYPE_CHECKING:
    from operator_app.session.ui.runner import Runner


class CalibrationOperations(Listener):
    """Operations on the calibration of a session; publishes the session's state and the quality of its poses.

    `solution`: the calibration from the current poses; None before there is one.
    """

    def __init__(self, session: Session, runner: Runner) -> None:
        self._session, self._runner = session, runner
        self.solution: Solution | None = None
        self._plan: tuple[Mapping[int, float], ...] = ()
        self._forecast: Forecast | None = None
        self._task: PlanningTask | None = None
        self._live: LiveQuality | None = None
        self._placed: EndpointConstraint | None = None

    def report(self, text: str, level: Level = Level.INFO) -> None:
        """Add a message for the operator."""
        self._runner.say(level, text)

    def _publish(self, **values: Any) -> None:
        self._runner.publish(lambda s: replace(s, **values))

    # -- quality of the poses ------------------------------------------------------------------------

    def refresh(self) -> None:
        """Publish the session's state and the quality of its poses; earlier results are reused where possible."""
        session, state = self._session, self._session.state
        used = state.used_poses
        if not used:
            self._live = self._placed = None
        else:
            q_rad = np.array([p.mean_rad for p in used])
            numbers = tuple(p.number for p in used)
            self._live = live_quality(
                session.model, self._loop_of(state), q_rad, numbers, earlier=self._live
            )
        if not state.solved:
            self.solution = None
        unvisited = [k for k in range(len(self._plan)) if k not in state.visited]
        self._publish(
            state=state,
            live=self._live,
            next_waypoint=unvisited[0] if unvisited else None,
            best_waypoint=self._most_informative_waypoint(state, unvisited),
            solution=self.solution,
        )

    def _set_plan(self, plan: tuple[Mapping[int, float], ...], start_rad: FloatArray) -> None:
        """Publish the waypoints `plan` (rad, by joint) and their predicted poses, starting from `start_rad` (n,)."""
        session, model = self._session, self._nominal_loop
        self._plan = plan
        self._forecast = predict(
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
        self._publish(plan=plan, forecast=self._forecast)

    def _most_informative_waypoint(self, state: SessionState, unvisited: list[int]) -> int | None:
        if self._live is None or self._forecast is None or self._task is None:
            return None
        names = [p.name for p in self._nominal_loop.parameters]
        return most_informative(
            self._task,
            self._live.x[[names.index(p.name) for p in self._task.model.parameters]],
            taken_rad=np.array([p.mean_rad for p in state.used_poses]),
            forecast=self._forecast,
            open_waypoints=unvisited,
        )

    def _loop_of(self, state: SessionState) -> ClosureModel:
        """Return the loop's model; on an open arm, locate the instrument first as soon as there are enough poses."""
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

    # -- calibration ---------------------------------------------------------------------------------

    def show_recorded_calibration(self) -> None:
        """Publish the recorded calibration and export of a resumed session, if there are any."""
        s = self._runner.snapshot()
        chosen: Any = {"estimator": s.estimator, "unsensed_joints": s.unsensed_joints}
        known = self._session.recorded_calibration(replace(s.procedure, **chosen))
        if self.solution is None and known is not None:
            self.solution, active = known.solution, self._active_document()
            exported = recorded_export(self._session, active)
            receipt = None if exported is None else exported.receipt
            self._publish(cross_checks=known.checks, written=exported, receipt=receipt)
            if known.solution.accepted:
                self._compare(active)

    def calibrate(self, estimator: str, unsensed_joints: tuple[int, ...]) -> None:
        """Calibrate in a separate process and publish each iteration; cancelling ends the process immediately."""
        self._publish(iterations=())
        steps: list[tuple[int, float]] = []

        def progress(number: int, cost: float) -> None:
            steps.append((number, cost))
            self._publish(iterations=tuple(steps))

        with SolvingProcess(self._session.raise_if_cancelled) as solver:
            self.solution = solution = self._session.calibrate(
                progress, estimator=estimator, unsensed_joints=unsensed_joints, solver=solver
            )
            # Published in one step, so that the solution is never shown with results of an earlier calibration.
            self._publish(
                solution=solution, cross_checks=None, written=None, diff=(), receipt=None,
                verification=None, report=None,
            )  # fmt: skip
            self.refresh()
            level = Level.INFO if solution.accepted else Level.WARNING
            self.report(f"calibrated from {solution.poses} poses: {solution.verdict.words}", level)
            # The cross-validation takes seconds: the verdict is shown first.
            checks = self._session.check(solution, solver)
        self._publish(cross_checks=checks)
        if solution.accepted:
            self._compare(self._active_document())

    def _compare(self, active_document: bytes) -> None:
        """Show the new parameters, and beside them those of the controller's `active_document` if it is not empty."""
        session, solution = self._session, self._current_solution()
        active = parse_parameters(active_document, "active parameters") if active_document else None
        self._publish(diff=diff_rows(session.document(solution), active))

    def _active_document(self) -> bytes:
        """Return the parameters document in the controller; empty if it has none, or if no arm is connected."""
        session = self._session
        return session.arm.active_parameters() if session.identity is not None else b""

    def write(self, *, upload: bool = False, forced: str = "") -> None:
        """Write parameters.yaml and poses.csv; if `upload`, also upload the parameters and read them back.

        Before an upload, the arm is held if its drives are enabled. `forced` is the reason for uploading a calibration
        that was not accepted.
        """
        session, solution = self._session, self._current_solution()
        joints = session.arm.snapshot().joints if upload else ()
        if any(j.drive is DriveState.OPERATION_ENABLED for j in joints):
            session.hold()
        exported = export(session, solution, upload_too=upload, forced=forced)
        self._publish(written=exported)
        self.refresh()
        receipt = exported.receipt
        if receipt is None:
            self.report(f"written: {exported.parameters}")
        else:
            self._publish(receipt=receipt)
            self._compare(self._active_document())
            self.report(
                f"uploaded to slot {receipt.slot} and read back: the same {receipt.length} bytes"
            )

    def verify(self, poses: int) -> None:
        """Capture new poses and test the current calibration with them."""
        result, _ = verify(self._session, self._current_solution(), poses, self)
        self.refresh()
        self._publish(verification=result)
        sigmas = result.in_use.best_table or result.verification.sigmas  # as step 7 shows them
        rms = SIGMA_POS(sigmas.position_m.rms).with_unit
        level = Level.INFO if result.holds else Level.WARNING
        self.report(f"{result.poses} new poses {result.verdict}: {rms} rms", level)

    def _current_solution(self) -> Solution:
        if self.solution is None:
            raise GuardError("There is no calibration of these poses", "Calibrate first (step 5)")
        return self.solution


def diff_rows(new: ParametersDocument, active: ParametersDocument | None) -> tuple[DiffRow, ...]:
    """Return a row for each calibrated entry of `new`: its value (rad or m) in `new` and, if given, in `active`."""
    now, before = new.table.stacked(), None if active is None else active.table.stacked()
    return tuple(
        DiffRow(
            name=entry.name,
            is_angle=entry.kind.is_angle,
            active=None if before is None else float(before[entry.kind, entry.row]),
            new=float(now[entry.kind, entry.row]),
        )
        for entry in (DhEntry.parse(c.entry) for c in new.calibrated)
    )

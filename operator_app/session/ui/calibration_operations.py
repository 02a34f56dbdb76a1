"""Operations of steps 5 to 7 (calibrate, compare, write, upload, verify), and what all operations publish.

They run in the worker thread and may block.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hardware.arm import DriveState
from operator_app.calibration.result import Solution
from operator_app.config.parameters import ParametersDocument
from operator_app.config.parameters_file import parse_parameters
from operator_app.errors import Cancelled, GuardError
from operator_app.session.store.solver_process import SolvingProcess
from operator_app.session.ui.pose_quality import PoseQuality
from operator_app.session.ui.snapshot import DiffRow, Level, Publisher
from operator_app.session.workflow.capture import verify
from operator_app.session.workflow.export import export, recorded_export
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from operator_app.units import SIGMA_POS
from solver.chain.parameters import DhEntry


class CalibrationOperations(Listener):
    """Operations on the calibration of a session; `solution` is that of the current poses, None before there is one."""

    def __init__(self, session: Session, publisher: Publisher) -> None:
        self._session, self._publisher = session, publisher
        self._pose_quality = PoseQuality(session)
        self.solution: Solution | None = None

    def report(self, text: str) -> None:
        """Add a message for the operator."""
        self._publisher.say(Level.INFO, text)

    def refresh(self) -> None:
        """Publish the session's state and the quality of its poses."""
        state, quality = self._session.state, self._pose_quality
        quality.evaluate(state)
        if not state.solved:
            self.solution = None
        self._publish(
            state=state,
            live=quality.live,
            next_waypoint=quality.next_waypoint,
            best_waypoint=quality.best_waypoint,
            solution=self.solution,
        )

    def _publish(self, **values: Any) -> None:
        """Replace these fields of the snapshot."""
        self._publisher.publish(lambda s: replace(s, **values))

    def show_recorded_calibration(self) -> None:
        """Publish the recorded calibration and export of a resumed session, if there are any."""
        known = self._session.recorded_calibration()
        if self.solution is None and known is not None:
            self.solution, active = known.solution, self._active_parameters()
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

        with SolvingProcess(self._raise_if_cancelled) as solver:
            self.solution = solution = self._session.calibrate(
                progress, estimator=estimator, unsensed_joints=unsensed_joints, solver=solver
            )
            # Published in one step, so that the solution is never shown with results of an earlier calibration.
            self._publish(
                solution=solution, cross_checks=None, written=None, diff=(), receipt=None,
                verification=None, report=None,
            )  # fmt: skip
            self.refresh()
            verdict = "accepted" if solution.accepted else "not accepted"
            self._publisher.say(
                Level.INFO if solution.accepted else Level.WARNING,
                f"calibrated from {solution.poses} poses: {verdict}",
            )
            # The cross-validation takes seconds: the verdict is shown first.
            checks = self._session.check(solution, solver)
        self._publish(cross_checks=checks)
        if solution.accepted:
            self._compare(self._active_parameters())

    def _raise_if_cancelled(self) -> None:
        if self._publisher.cancelled():
            raise Cancelled

    def _active_parameters(self) -> bytes:
        """Read the controller's active document; empty without a connected arm or a document."""
        session = self._session
        return session.arm.active_parameters() if session.identity is not None else b""

    def _compare(self, active_document: bytes) -> None:
        """Publish the differences from the parameters active in the controller."""
        session, solution = self._session, self._current_solution()
        active = parse_parameters(active_document, "active parameters") if active_document else None
        self._publish(diff=diff_rows(session.document(solution), active))

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
            self._compare(self._active_parameters())
            self.report(
                f"uploaded to slot {receipt.slot} and read back: the same {receipt.length} bytes"
            )

    def verify(self, poses: int) -> None:
        """Capture new poses and test the current calibration with them."""
        result, _ = verify(self._session, self._current_solution(), poses, self)
        self.refresh()
        self._publish(verification=result)
        self._publisher.say(
            Level.INFO if result.holds else Level.WARNING,
            f"{result.poses} new poses {result.verdict}: "
            f"{SIGMA_POS(result.verification.sigmas.position_m.rms).with_unit} rms",
        )

    def _current_solution(self) -> Solution:
        if self.solution is None:
            raise GuardError("There is no calibration of these poses", "Calibrate first (step 5)")
        return self.solution


def diff_rows(new: ParametersDocument, active: ParametersDocument | None) -> tuple[DiffRow, ...]:
    """Return the active value (None if there is none) and the new value, rad or m, of each calibrated entry."""
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

"""The calibration in hand: solved, checked, compared with the controller's, written, uploaded, verified.

Every function runs on the worker's thread and may block. Knows no thread and no screen.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace

from hardware.arm import DriveState
from operator_app.calibration.result import Solution
from operator_app.config.parameters import ParametersDocument
from operator_app.config.parameters_file import parse_parameters
from operator_app.errors import Cancelled, GuardError
from operator_app.session.store.solver_process import Solver, SolvingProcess
from operator_app.session.ui.snapshot import DiffRow, Iteration, Level, Publisher, Verified, Written
from operator_app.session.workflow.capture import verify
from operator_app.session.workflow.export import export
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from operator_app.units.figure import SIGMA_POS
from solver.chain.parameters import DhEntry


class Results:
    """What is concluded from a session's poses.

    Parameters
    ----------
    refresh
        Publishes the session's state and what its poses are worth.

    Attributes
    ----------
    solution
        The last calibration, None where there is none of these poses.
    """

    def __init__(
        self,
        session: Session,
        publisher: Publisher,
        listener: Listener,
        refresh: Callable[[], None],
    ) -> None:
        self._session, self._publisher, self._listener = session, publisher, listener
        self._refresh = refresh
        self.solution: Solution | None = None

    def show_what_is_known(self) -> None:
        """Show the calibration of a resumed session, which is not solved again."""
        known = self._session.calibrated()
        if self.solution is None and known is not None:
            self.solution = known.solution
            self._publisher.publish(lambda s: replace(s, checks_of_it=known.checks))
            if known.solution.accepted:
                self._compare()

    def calibrate(self, estimator: str, unsensed_joints: tuple[int, ...]) -> None:
        """Calibrate, in a process of its own; each iteration is published, and cancelling ends it at once."""
        self._publisher.publish(lambda s: replace(s, iterations=()))
        with SolvingProcess(self._go_on) as process:
            self._calibrate(process, estimator, unsensed_joints)

    def _go_on(self) -> None:
        if self._publisher.cancelled():
            raise Cancelled

    def _calibrate(self, solver: Solver, estimator: str, unsensed_joints: tuple[int, ...]) -> None:
        steps: list[Iteration] = []

        def progress(number: int, cost: float) -> None:
            steps.append(Iteration(number=number, cost=cost))
            self._publisher.publish(lambda s: replace(s, iterations=tuple(steps)))

        solution = self._session.calibrate(
            progress, estimator=estimator, unsensed_joints=unsensed_joints, solver=solver
        )
        self.solution = solution
        # All at once, and only now: what was said of an earlier calibration does not hold for this one.
        self._publisher.publish(
            lambda s: replace(
                s, solution=solution, checks_of_it=None, written=None, diff=(), receipt=None,
                verification=None, report=None,
            )
        )  # fmt: skip
        self._refresh()
        verdict = "accepted" if solution.accepted else "not accepted"
        self._publisher.say(
            Level.INFO if solution.accepted else Level.WARNING,
            f"calibrated from {solution.poses} poses: {verdict}",
        )
        # Five smaller calibrations and one per pose: seconds, so the verdict is shown before.
        found = self._session.check(solution, solver)
        self._publisher.publish(lambda s: replace(s, checks_of_it=found))
        if solution.accepted:
            self._compare()

    def _compare(self) -> None:
        """Compare what would be written with what is active on the controller."""
        session, solution = self._session, self._in_hand()
        active_bytes = session.arm.active_parameters() if session.identity is not None else b""
        active = parse_parameters(active_bytes, "active parameters") if active_bytes else None
        rows = diff_rows(session.document(solution), active)
        self._publisher.publish(lambda s: replace(s, diff=rows))

    def write(self) -> None:
        """Write the session's files."""
        self._export(upload_too=False)

    def upload(self, forced: str = "") -> None:
        """Write the files, hold the arm, upload, read back; `forced` says why, if it was not accepted.

        Drives that are off stay so: it is a file transfer.
        """
        session = self._session
        if any(j.drive is DriveState.OPERATION_ENABLED for j in session.arm.snapshot().joints):
            session.hold()
        self._export(upload_too=True, forced=forced)

    def _export(self, *, upload_too: bool, forced: str = "") -> None:
        exported = export(self._session, self._in_hand(), upload_too=upload_too, forced=forced)
        digest = hashlib.sha256(exported.parameters.read_bytes()).hexdigest()
        written = Written(
            folder=exported.folder,
            parameters=exported.parameters,
            poses=exported.poses,
            sha256=digest,
        )
        self._publisher.publish(lambda s: replace(s, written=written))
        self._refresh()
        if exported.receipt is None:
            self._publisher.say(Level.INFO, f"written: {exported.parameters}")
        else:
            self._publisher.publish(lambda s: replace(s, receipt=exported.receipt))
            self._compare()
            self._publisher.say(
                Level.INFO,
                f"uploaded to slot {exported.receipt.slot} and read back: the same "
                f"{exported.receipt.length} bytes",
            )

    def verify(self, poses: int) -> None:
        """Take new poses elsewhere and judge them by the parameters as they are; any key ends it."""
        verdict, _ = verify(self._session, self._in_hand(), poses, self._listener)
        judged = verdict.verification
        turned = judged.sigmas.orientation_rad
        found = Verified(
            poses=verdict.poses,
            position_m=judged.sigmas.position_m.rms,
            orientation_rad=None if turned is None else turned.rms,
            chi2_per_dof=judged.chi2.per_dof,
            holds=verdict.holds,
            why=verdict.why,
        )
        self._refresh()
        self._publisher.publish(lambda s: replace(s, verification=found))
        self._publisher.say(
            Level.INFO if found.holds else Level.WARNING,
            f"{found.poses} new poses, {found.verdict}: {SIGMA_POS(found.position_m).with_unit} rms",
        )

    def _in_hand(self) -> Solution:
        if self.solution is None:
            raise GuardError("There is no calibration of these poses", "Calibrate first (step 5)")
        return self.solution


def diff_rows(new: ParametersDocument, active: ParametersDocument | None) -> tuple[DiffRow, ...]:
    """Every calibrated entry: what is active (None: nothing), what would be; rad and m."""
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

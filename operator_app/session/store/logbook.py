"""The part of a session that needs no arm: journal and state, edits of poses, calibration, documents.

Every event is in the journal before it changes the state.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from fixtures.base import EndpointConstraint
from operator_app.calibration.cross_validation import Checks, check
from operator_app.calibration.result import Solution
from operator_app.calibration.serialization import to_dict
from operator_app.config.parameters_file import ParametersDocument
from operator_app.config.poses_file import save_poses
from operator_app.config.procedure import Procedure
from operator_app.errors import GuardError
from operator_app.session.store.folders import POSES_NAME
from operator_app.session.store.journal import Journal
from operator_app.session.store.parameters_document import parameters_document
from operator_app.session.store.replay import apply, session_state
from operator_app.session.store.solver_process import Solver, solve_here
from operator_app.session.store.state import CapturedPose, SessionState
from operator_app.session.store.stored_calibration import (
    StoredCalibration,
    journal_calibration,
    solution_data,
    solve,
)
from operator_app.session.store.true_errors import Truths, with_truth
from solver.chain.arm_model import ArmModel
from solver.estimators.least_squares import Progress


class Logbook:
    """Journal and state of a session.

    `state`: the state after the events of `journal`. `model`, `fixture`: the procedure's arm and fixture. `truths`:
    true parameters of a simulated arm; None for a real arm.
    """

    def __init__(
        self, journal: Journal, procedure: Procedure, truths: Truths | None = None
    ) -> None:
        self.model: ArmModel = procedure.arm
        self.fixture: EndpointConstraint = procedure.fixture.fixture
        self.procedure = procedure
        self.journal, self.truths = journal, truths
        self.state: SessionState = session_state(
            journal.contents, joint_count=procedure.arm.joint_count
        )

    def record(self, name: str, data: Mapping[str, Any]) -> None:
        """Write an event to the journal, then apply it to the state."""
        self.state = apply(self.state, self.journal.append(name, data))

    def require_journal(self, *, unchanged: bool = False) -> None:
        """Raise JournalLostError if the journal file is lost; with `unchanged`, a changed line is a loss too."""
        self.journal.require_intact(unchanged=unchanged)

    # -- poses -----------------------------------------------------------------------------------

    def undo(self) -> CapturedPose:
        """Remove and return the last pose of the current placement; raises `GuardError` if there is none."""
        poses = [p for p in self.state.poses if p.placement == self.state.placement]
        if not poses:
            raise GuardError("this placement has no pose to undo", "capture one first")
        last = poses[-1]
        self.record("pose_undone", {"number": last.number})
        return last

    def restore(self, number: int) -> None:
        """Restore an undone pose."""
        self.record("pose_restored", {"number": number})

    def exclude(self, number: int, reason: str) -> None:
        """Exclude a pose from the calibration; it stays in the journal."""
        self._require_pose(number)
        self.record("pose_excluded", {"number": number, "text": reason or "by the operator"})

    def include(self, number: int) -> None:
        """Include an excluded pose again."""
        self._require_pose(number)
        self.record("pose_included", {"number": number})

    def note(self, number: int, text: str) -> None:
        """Attach a note to a pose."""
        self._require_pose(number)
        self.record("pose_noted", {"number": number, "text": text})

    def _require_pose(self, number: int) -> None:
        if self.state.pose(number) is None:
            known = ", ".join(str(p.number) for p in self.state.poses) or "none"
            raise GuardError(f"there is no pose {number}", f"captured poses: {known}")

    # -- calibration -----------------------------------------------------------------------------

    def recorded_calibration(self, options: Procedure | None = None) -> StoredCalibration | None:
        """Return the journal's calibration; None if poses, repeats or `options` (default: own) have changed since."""
        own, then = options or self.procedure, {"rereads": 0, **self.state.solved}
        now = {
            "estimator": own.estimator,
            "unsensed_joints": sorted({*own.unsensed_joints, *self.model.unsensed_joints}),
            "length_tolerance_m": own.length_tolerance_m,
            # If a pose was measured again after the calibration, the diagnosis may change.
            "rereads": len(self.state.rereads),
        }
        if any(then.get(key) != value for key, value in now.items()):
            return None
        calibration = journal_calibration(self.state)
        return calibration if isinstance(calibration, StoredCalibration) else None

    def calibrate(
        self, progress: Progress | None = None, *, solver: Solver = solve_here, **options: Any
    ) -> Solution:
        """Calibrate from the used poses and record the solution; `options` override those of the procedure.

        First writes poses.csv beside the journal, so that it exists even if the calibration fails.
        """
        save_poses(self.journal.path.parent / POSES_NAME, self.state.pose_set())
        procedure = replace(self.procedure, **options)
        solution = solve(self.state, procedure, solver=solver, progress=progress)
        if self.truths is not None:
            last = max(p.placement for p in self.state.used_poses)
            solution = with_truth(solution, self.model, self.truths, last=last)
        self.record_solution(solution)
        return solution

    def record_solution(self, solution: Solution) -> None:
        """Record a solution from the used poses; raises JournalLostError if the journal has changed."""
        self.require_journal(unchanged=True)
        self.record("solved", solution_data(solution, self.state, self.procedure))

    def check(self, solution: Solution, solver: Solver = solve_here) -> Checks:
        """Cross-validate `solution`, which must be the last recorded one, and record the result."""
        checks = solver(check, solution, self.model, self.fixture, self.state.pose_set())
        self.record("checked", {"record": to_dict(checks)})
        return checks

    def document(self, solution: Solution, *, forced: str = "") -> ParametersDocument:
        """Return the parameters document of a calibration; `forced`: reason for exporting it without acceptance."""
        return parameters_document(solution, self.state, self.procedure, forced=forced)

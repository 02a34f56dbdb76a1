"""A session's journal, and what is made of the poses in it: edits, calibration, documents. Needs no arm.

Every fact is in the journal before it counts. What is done with an arm is `session`'s affair.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import Checks, check
from operator_app.calibration.serialization import to_dict
from operator_app.calibration.truth import with_truth
from operator_app.config.poses_file import save_poses
from operator_app.errors import GuardError
from operator_app.session.store.folders import POSES_NAME
from operator_app.session.store.parameters import document_of
from operator_app.session.store.replay import apply, session_state
from operator_app.session.store.solver_process import Solver, solve_here
from operator_app.session.store.stored_calibration import (
    StoredCalibration,
    recorded,
    solved_data,
    unreturned_notices,
)

if TYPE_CHECKING:
    from fixtures.base import Fixture
    from operator_app.calibration.result import Solution
    from operator_app.calibration.truth import Truths
    from operator_app.config.parameters import ParametersDocument
    from operator_app.config.procedure import Procedure
    from operator_app.session.store.journal import Clock, Journal
    from operator_app.session.store.state import CapturedPose, SessionState
    from solver.chain.arm_model import ArmModel
    from solver.estimators.least_squares import Progress


class Logbook:
    """What a session knows.

    Attributes
    ----------
    journal, state
        The events, and what they amount to.
    procedure, model, fixture
        What is followed; its arm and its fixture.
    truths
        What a simulated arm truly is; None of a real one.
    """

    def __init__(self, *, journal: Journal, procedure: Procedure, clock: Clock) -> None:
        self.model: ArmModel = procedure.arm
        self.fixture: Fixture = procedure.fixture.fixture
        self.procedure = procedure
        self.journal = journal
        self.truths: Truths | None = None
        self._clock = clock
        self.state: SessionState = session_state(
            journal.contents, joint_count=procedure.arm.joint_count
        )

    def record(self, name: str, data: Mapping[str, Any]) -> None:
        """Write an event and let it count; in this order, so that nothing unwritten counts."""
        event = self.journal.append(name, data, clock=self._clock)
        self.state = apply(self.state, event.name, event.data, event.utc)

    def require_journal(self, *, unchanged: bool = False) -> None:
        """Refuse to go on where the journal is gone or, with `unchanged`, not what was written."""
        self.journal.require_there(unchanged=unchanged)

    # -- poses -----------------------------------------------------------------------------------

    def undo(self) -> CapturedPose:
        """Take back the last pose that counts."""
        here = [p for p in self.state.poses if p.placement == self.state.placement]
        if not here:
            raise GuardError("there is no pose of this placement to take back", "capture one first")
        last = here[-1]
        self.record("pose_undone", {"number": last.number})
        return last

    def restore(self, number: int) -> None:
        """Let a pose that was taken back count again, as it was."""
        if all(pose.number != number for pose in self.state.undone):
            raise GuardError(f"pose {number} was not taken back", "capture a pose")
        self.record("pose_restored", {"number": number})

    def exclude(self, number: int, reason: str) -> None:
        """Leave a pose out of the calibration; it stays in the journal."""
        self._require_pose(number)
        self.record("pose_excluded", {"number": number, "text": reason or "by the operator"})

    def include(self, number: int) -> None:
        """Let an excluded pose count again."""
        self._require_pose(number)
        self.record("pose_included", {"number": number})

    def note(self, number: int, text: str) -> None:
        """Attach a note to a pose."""
        self._require_pose(number)
        self.record("pose_noted", {"number": number, "text": text})

    def _require_pose(self, number: int) -> None:
        if all(pose.number != number for pose in self.state.poses):
            known = ", ".join(str(p.number) for p in self.state.poses) or "none"
            raise GuardError(f"there is no pose {number}", f"captured poses: {known}")

    # -- calibration -----------------------------------------------------------------------------

    def calibrated(self) -> StoredCalibration | None:
        """Return what the journal has of these poses, if they were solved as the procedure says."""
        own, then = self.procedure, self.state.solved
        asked = (
            own.estimator,
            sorted({*own.unsensed_joints, *self.model.unsensed_joints}),
            own.length_tolerance_m,
        )
        keys = ("estimator", "unsensed_joints", "length_tolerance_m")
        if not then or tuple(then.get(k) for k in keys) != asked:
            return None
        if then.get("rereads", 0) != len(self.state.rereads):
            # The arm came back to a pose since: that may speak against it.
            return None
        found = recorded(self.state)
        return found if isinstance(found, StoredCalibration) else None

    def calibrate(
        self,
        progress: Progress | None = None,
        *,
        estimator: str | None = None,
        unsensed_joints: tuple[int, ...] | None = None,
        solver: Solver = solve_here,
    ) -> Solution:
        """Calibrate from the poses that count, by default as the procedure says and in this process.

        They are written beside the journal first: whoever is not content with the result wants them.
        """
        own, poses = self.procedure, self.state.pose_set()
        save_poses(self.journal.path.parent / POSES_NAME, poses)
        solution = solver(
            calibrate,
            self.model,
            self.fixture,
            poses,
            estimator=own.estimator if estimator is None else estimator,
            unsensed_joints=own.unsensed_joints if unsensed_joints is None else unsensed_joints,
            length_tolerance_m=own.length_tolerance_m,
            limits=own.acceptance,
            rereads=self.state.rereads,
            progress=progress,
        )
        solution = solution.with_notices(unreturned_notices(self.state))
        if self.truths is not None:
            first = min(p.placement for p in self.state.used_poses)
            solution = with_truth(solution, self.model, self.truths, first=first)
        self.record_solution(solution)
        return solution

    def record_solution(self, solution: Solution) -> None:
        """Keep a solution of the poses that count, as long as the journal still holds them."""
        self.require_journal(unchanged=True)
        kept = solved_data(
            solution, self.state, length_tolerance_m=self.procedure.length_tolerance_m
        )
        self.record("solved", kept)

    def check(self, solution: Solution, solver: Solver = solve_here) -> Checks:
        """Ask for second opinions on the last calibration, and keep them."""
        found = solver(check, solution, self.model, self.fixture, self.state.pose_set())
        self.record("checked", {"record": to_dict(found)})
        return found

    def document(self, solution: Solution, *, forced: str = "") -> ParametersDocument:
        """Return what an export of this calibration would write."""
        return document_of(solution, self.state, self.procedure, utc=self._clock(), forced=forced)

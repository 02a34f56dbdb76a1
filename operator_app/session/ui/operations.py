"""Operations of steps 1 to 4. They run in the worker thread, may block, and put results into the snapshot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from operator_app.errors import GuardError
from operator_app.messages.errors import configured_words, unwatching_words
from operator_app.session.store.state import SessionState
from operator_app.session.ui.calibration_operations import CalibrationOperations
from operator_app.session.ui.snapshot import Level
from operator_app.session.workflow import drive_selection
from operator_app.session.workflow.capture import outlier_warning, place_warning, take_poses
from operator_app.session.workflow.session import Session
from operator_app.units import MOVED, READING_SD, names, others_free
from solver.chain.parameters import nominal_vector
from solver.design.actions import GoTo
from solver.design.drive_joints import RankedDrives, rank_at_pose

if TYPE_CHECKING:
    from operator_app.session.ui.runner import Runner

TEST_WIGGLE_RAD = float(np.deg2rad(2.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edit:
    """An edit of the pose `pose`, and functions to undo and redo the edit; `captured`: number of captures before it."""

    pose: int
    undo: Callable[[], object]
    redo: Callable[[], object]
    captured: int


class Operations(CalibrationOperations):
    """The operations of all seven steps; they put their progress and results into the snapshot."""

    def __init__(self, session: Session, runner: Runner) -> None:
        super().__init__(session, runner)
        session.cancelled = runner.cancelled
        session.instruct = self.report
        self._edits: list[_Edit] = []
        self._undone: list[_Edit] = []

    # -- 1 Connect, 2 Fixture ----------------------------------------------------------------------

    def connect(self) -> None:
        """Connect to the arm, check it, and check the fixture at the current pose.

        First records, if a mounting must be confirmed, that the fixture is mounted: the operator has been asked.
        """
        self._session.mounted()
        self._session.release_holding()
        self._publish(identity=None)
        try:
            identity = self._session.connect()
        finally:
            self._publish(identity=self._session.identity)
        self._publish(stop=None, at_waypoint=None)
        if identity.simulated:
            # The nodes themselves report that they are simulated, whatever the bus.
            self._publish(simulated=True)
        if identity.by_hand:
            # A person moves this arm by hand: there is no hardware stop to test.
            self._publish(stop_tested=True)
        self.report(
            f"connected to {identity.model}, serial {identity.serial_number}, "
            f"{len(identity.nodes)} nodes"
        )
        if configured := configured_words(identity):
            self.report(configured)
        if configured := unwatching_words(identity):
            self.report(configured, Level.WARNING)
        self.show_recorded_calibration()
        self.check_fixture()

    def check_fixture(self) -> None:
        """Check the fixture, rank the drive joints, predict the poses of the plan."""
        session = self._session
        checks = session.check_fixture()
        q_rad = session.arm.snapshot().positions_rad
        model = session.fixture.model(session.model)
        joints = session.procedure.position_joints
        ranked: tuple[RankedDrives, ...] = ()
        if not session.fixture.holds_hand:
            joints = tuple(range(1, session.model.joint_count + 1))
        else:
            ranked = rank_at_pose(model, nominal_vector(model.parameters), q_rad)
        if joints is None:
            choice = drive_selection.choose(session, may_move=False)
            joints, ranked = choice.drives, choice.ranked
        best = ranked[0].drives if ranked else joints
        self._runner.publish(
            lambda s: replace(
                s, checks=checks, ranked=ranked, selected_joints=s.selected_joints or best
            )
        )
        start = session.state.start_rad
        if start is not None and len(session.state.position_joints) == session.mobility:
            # The session already has a plan, which starts at `start`.
            self._set_plan(drive_selection.waypoints_of(session), start)
        elif len(joints) == session.mobility:
            self._set_plan(drive_selection.waypoints_from(session, q_rad, joints), q_rad)
        self.refresh()

    # -- 3 Modes -----------------------------------------------------------------------------------

    def set_modes(self, position_joints: tuple[int, ...]) -> None:
        """Enable the drives, set the modes and read them back, and predict the poses of the plan."""
        session = self._session
        session.set_modes(position_joints)
        driven = names(f"J{j}" for j in position_joints)
        others = others_free(len(position_joints), len(session.state.modes))
        self.report(f"{driven} in position mode{others}: read back")
        start = session.state.start_rad
        if start is not None:
            self._set_plan(drive_selection.waypoints_of(session), start)
        self.refresh()

    def wiggle(self) -> None:
        """Move each drive joint by 2 deg and back; report how the other joints follow."""
        self._publish(at_waypoint=None)
        session, lines = self._session, []
        for joint in session.state.position_joints:
            before = session.arm.snapshot().positions_rad
            away = session.go_to({joint: float(before[joint - 1]) + TEST_WIGGLE_RAD})
            positions = session.arm.snapshot().positions_rad
            back = session.go_to({joint: float(before[joint - 1])})
            if not (away.reached and back.reached):
                raise GuardError(
                    f"The trial wiggle of J{joint} was stopped: {away.reason or back.reason}",
                    "Clear the way before anything else moves",
                )
            changes = [MOVED(v) for v in (positions - before).tolist()]
            followed = ", ".join(f"J{j} {m.shown}" for j, m in enumerate(changes, 1) if j != joint)
            unit = MOVED.quantity.unit
            lines.append(f"J{joint} {changes[joint - 1].with_unit} moved {followed} {unit}")
        self._publish(wiggle="; ".join(lines))
        self.report("trial wiggle done: " + "; ".join(lines))

    def go_home(self) -> None:
        """Move the drive joints home at 5 deg/s."""
        self._publish(at_waypoint=None)
        message = drive_selection.go_home(self._session)
        self.refresh()
        self.report(message)

    # -- 4 Capture ---------------------------------------------------------------------------------

    def go(self, waypoint: int) -> None:
        """Move to a waypoint (index from 0)."""
        self._publish(at_waypoint=None)
        arrived = drive_selection.visit(self._session, waypoint)
        self._publish(at_waypoint=waypoint if arrived else None)
        if arrived:
            self.report(f"at waypoint {waypoint + 1}: capture at standstill")
        else:
            self.report(f"waypoint {waypoint + 1} cannot be reached and was skipped", Level.WARNING)
        self.refresh()

    def capture(self, waypoint: int) -> None:
        """Capture a pose at the current position; `waypoint`: its index (from 0) in the plan, -1 if not in the plan."""
        self._session.capture(waypoint)
        self.pose_captured(self._session.state)
        if text := place_warning(self._session):
            self.report(text, Level.WARNING)
        if suspect := outlier_warning(self._session):
            # A planned capture that makes a new plan has no path back to the first pose.
            if self._session.procedure.capture.strategy != "planned":
                first = self._session.state.poses_here[0].number
                suspect += (
                    f" The automatic capture measures pose {first} again first (drift check)."
                )
            self.report(suspect, Level.WARNING)

    def automatic(self) -> None:
        """Capture the missing poses by the strategy of the procedure, explored or planned."""
        try:
            end = take_poses(self._session, self)
        finally:
            self._publish(heading=None)
        self.refresh()
        if end is None:
            self.report(f"all {self._session.procedure.capture.poses} poses captured")
        elif end.complete:
            self.report(f"capture complete: {end.text}")
        else:
            self.report(f"capture ended: {end.text}", Level.WARNING)

    def undo(self) -> None:
        """Undo the last exclusion or note since the last capture; if there is none, remove the last pose."""
        session = self._session
        if self._edits and self._edits[-1].captured == session.state.captured:
            edit = self._edits.pop()
            edit.undo()
            message = f"the last change of pose {edit.pose} is undone"
        else:
            self._edits.clear()
            number = session.undo().number
            restore = partial(session.restore, number)
            edit = _Edit(
                pose=number, undo=session.undo, redo=restore, captured=session.state.captured
            )
            message = f"pose {number} is removed"
        self._undone.append(edit)
        self.refresh()
        self.report(message)

    def redo(self) -> None:
        """Redo the last undone change; raises GuardError if there is none, or a pose was captured since."""
        if not self._undone or self._undone[-1].captured != self._session.state.captured:
            raise GuardError("There is nothing to redo", "Undo a change first (u)")
        edit = self._undone.pop()
        edit.redo()
        self._edits.append(edit)
        self.refresh()
        self.report(f"the change of pose {edit.pose} is redone")

    def exclude(self, number: int) -> None:
        """Exclude a pose or, if it is excluded, include it again."""
        session, pose = self._session, self._session.state.pose(number)
        reason = "" if pose is None else pose.excluded
        include = partial(session.include, number)
        exclude = partial(session.exclude, number, reason)
        self._edit(number, *((include, exclude) if reason else (exclude, include)))
        now = "included again" if reason else "excluded: it stays in the journal"
        self.report(f"pose {number} {now}")

    def note(self, number: int, text: str) -> None:
        """Attach a note to a pose."""
        pose = self._session.state.pose(number)
        before = "" if pose is None else pose.note
        note = partial(self._session.note, number)
        self._edit(number, partial(note, text), partial(note, before))

    def _edit(self, pose: int, do: Callable[[], object], undo: Callable[[], object]) -> None:
        do()
        captured = self._session.state.captured
        self._edits.append(_Edit(pose=pose, undo=undo, redo=do, captured=captured))
        self._undone.clear()
        self.refresh()

    # -- 7 Export ----------------------------------------------------------------------------------

    def verify(self, poses: int, joints: tuple[int, ...] = ()) -> None:
        """Put `joints`, if any, into position mode, then verify the calibration with `poses` new poses."""
        if joints:
            self.set_modes(joints)
        super().verify(poses)

    # -- any time ----------------------------------------------------------------------------------

    def reset(self) -> None:
        """Clear STOP and drive faults; the drives stay disabled."""
        arm = self._session.arm.snapshot()
        cleared = "STOP" if arm.stopped else "drive faults"
        self._session.reset_stop()
        self.refresh()  # a failed sensor may have been recorded
        if self._session.arm.snapshot().stopped:  # pressed again meanwhile
            return
        self._publish(stop=None)
        self.report(f"{cleared} reset: nothing moves; apply the modes again (step 3)")

    def hold(self) -> None:
        """Put all joints into position mode; they hold their current positions."""
        self._publish(at_waypoint=None)
        self._session.hold()
        self.refresh()

    # -- progress of a capture ---------------------------------------------------------------------

    def going(self, move: GoTo | None) -> None:
        """Publish the planned move that is about to start; None for any other motion."""
        self._publish(at_waypoint=None, heading=move)

    def planning(self, *, active: bool) -> None:
        """Publish whether the next poses are being planned."""
        self._runner.publish(
            lambda s: s if s.task is None else replace(s, task=replace(s.task, planning=active))
        )

    def arrived(self, waypoint: int) -> None:
        """Publish the waypoint where the arm is."""
        self._publish(at_waypoint=waypoint)

    def pose_captured(self, state: SessionState, total: int = 0) -> None:
        """Publish and report the last captured pose; `total`, the number of required poses, is not used here."""
        self.refresh()
        pose = state.poses[-1]
        noise = READING_SD(float(pose.sd_rad.max())).with_unit
        self.report(f"pose {pose.number} captured (noise up to {noise})")

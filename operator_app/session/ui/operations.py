"""What the worker does for the operator: each step's work on a session, publishing what it found.

Every function runs on the worker's thread and may block. Knows no thread and no screen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from operator_app.errors import GuardError
from operator_app.messages.errors import configured_words, unwatching_words
from operator_app.planning.mode_rule import and_the_others
from operator_app.session.store.state import CapturedPose, SessionState
from operator_app.session.ui.calibration_operations import Results
from operator_app.session.ui.pose_quality import Appraisal
from operator_app.session.ui.snapshot import Level, Publisher
from operator_app.session.workflow.capture import doubt, take_poses
from operator_app.session.workflow.drive_box import go_home, waypoints_from, waypoints_of
from operator_app.session.workflow.drive_selection import choose_by_prediction
from operator_app.session.workflow.exploration import visit
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from operator_app.units.figure import MOVED, READING_SD
from operator_app.units.numbers import names
from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.design.actions import GoTo
from solver.design.drive_joints import RankedDrives, rank_at_pose

WIGGLE_RAD = float(np.deg2rad(2.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edit:
    """A pose before it was edited or taken back, and how many there were then: a capture since comes first."""

    before: CapturedPose
    captured: int
    taken_back: bool = False


class Operations:
    """The work of the seven steps.

    Attributes
    ----------
    results
        Of steps 5 to 7.
    """

    def __init__(self, session: Session, publisher: Publisher) -> None:
        self._session = session
        self._publisher = publisher
        self._listener = _Publishing(self, publisher)
        session.cancelled = publisher.cancelled
        session.told = lambda text: publisher.say(Level.INFO, text)
        self._appraisal = Appraisal(session)
        self._edits: list[_Edit] = []
        self._undone: list[_Edit] = []
        self.results = Results(session, publisher, self._listener, self.refresh)

    # -- 1 Connect, 2 Fixture ----------------------------------------------------------------------

    def connect_mounted(self) -> None:
        """Keep that the fixture is mounted, as somebody said, then connect."""
        self._session.mounted()
        self.connect()

    def connect(self) -> None:
        """Find the arm, or find it again; check it, and judge the fixture where the arm stands."""
        self._session.let_go()
        # What was seen of it before is not so any more, whether it is found again or not.
        self._publisher.publish(lambda s: replace(s, identity=None))
        try:
            identity = self._session.connect()
        finally:
            self._publisher.publish(lambda s: replace(s, identity=self._session.identity))
        self._publisher.publish(lambda s: replace(s, stop=None, at_waypoint=None))
        if identity.simulated:
            # On whatever bus: these nodes say themselves that nothing real moves.
            self._publisher.publish(lambda s: replace(s, simulated=True))
        if identity.by_hand:
            # Nothing that a hardware stop could stop: whoever moves it lets go.
            self._publisher.publish(lambda s: replace(s, stop_tested=True))
        self._publisher.say(
            Level.INFO,
            f"connected to {identity.model}, serial {identity.serial_number}, "
            f"{len(identity.nodes)} nodes",
        )
        if words := configured_words(identity):
            self._publisher.say(Level.INFO, words)
        if words := unwatching_words(identity):
            self._publisher.say(Level.WARNING, words)
        self.results.show_what_is_known()
        self.check_fixture()

    def check_fixture(self) -> None:
        """Judge the placement, rank the drive joints, predict the plan."""
        session = self._session
        checks = session.check_fixture()
        here = session.arm.snapshot().positions_rad
        model = session.fixture.model(session.model)
        joints = session.procedure.position_joints
        ranked: tuple[RankedDrives, ...] = ()
        if not session.fixture.holds_hand:
            # Nothing to choose: every joint is driven.
            joints = tuple(range(1, session.model.joint_count + 1))
        else:
            ranked = rank_at_pose(model, nominal_vector(model.parameters), here)
        if joints is None:
            choice = choose_by_prediction(session)
            joints, ranked = choice.drives, choice.ranked
        best = ranked[0].drives if ranked else joints
        self._publisher.publish(
            lambda s: replace(
                s, checks=checks, ranked=ranked, wanted_joints=s.wanted_joints or best
            )
        )
        start = session.state.start_rad
        if start is not None and len(session.position_joints) == session.mobility:
            # The plan that is followed, not one that would begin here.
            self._foresee(waypoints_of(session), start)
        elif len(joints) == session.mobility:
            self._foresee(waypoints_from(session, here, joints), here)
        self.refresh()

    def confirm(self, item: str, text: str) -> None:
        """Record what the operator has confirmed."""
        self._session.record("confirmed", {"item": item, "text": text})

    # -- 3 Modes -----------------------------------------------------------------------------------

    def set_modes(self, position_joints: tuple[int, ...]) -> None:
        """Take control, set the modes, read them back, and lay out the plan."""
        session = self._session
        session.set_modes(position_joints)
        driven = names(f"J{j}" for j in position_joints)
        others = and_the_others(len(position_joints), len(session.state.modes))
        self._publisher.say(Level.INFO, f"{driven} in position mode{others}: read back")
        start = session.state.start_rad
        if start is not None:
            self._foresee(waypoints_of(session), start)
        self.refresh()

    def wiggle(self) -> None:
        """Move each drive joint a little, there and back, and say what followed."""
        self._at(None)
        session, said = self._session, []
        for joint in session.position_joints:
            before = session.arm.snapshot().positions_rad
            away = session.go_to({joint: float(before[joint - 1]) + WIGGLE_RAD})
            there = session.arm.snapshot().positions_rad
            back = session.go_to({joint: float(before[joint - 1])})
            if not (away.reached and back.reached):
                raise GuardError(
                    f"The trial wiggle of J{joint} was stopped: {away.reason or back.reason}",
                    "Look at what is in the way before anything else moves",
                )
            moved = [MOVED(v) for v in (there - before).tolist()]
            followed = ", ".join(f"J{j} {m.shown}" for j, m in enumerate(moved, 1) if j != joint)
            unit = MOVED.quantity.unit
            said.append(f"J{joint} {moved[joint - 1].with_unit} moved {followed} {unit}")
        self._publisher.publish(lambda s: replace(s, wiggle="; ".join(said)))
        self._publisher.say(Level.INFO, "trial wiggle done: " + "; ".join(said))

    def go_home(self) -> None:
        """Take the drive joints home, slowly; any key ends it."""
        self._at(None)
        said = go_home(self._session)
        self.refresh()
        self._publisher.say(Level.INFO, said)

    # -- 4 Capture ---------------------------------------------------------------------------------

    def go(self, waypoint: int) -> None:
        """Move to a waypoint; any key ends it."""
        self._at(None)
        reached = visit(self._session, waypoint)
        self._at(waypoint if reached else None)
        if reached:
            self._publisher.say(Level.INFO, f"at waypoint {waypoint + 1}: capture when still")
        else:
            self._publisher.say(
                Level.WARNING, f"waypoint {waypoint + 1} cannot be reached and was passed over"
            )
        self.refresh()

    def capture(self, waypoint: int) -> None:
        """Settle, read, keep."""
        self._session.capture(waypoint)
        self.captured(self._session.state.poses[-1])
        if doubted := doubt(self._session):
            # Nothing moves that nobody asked for; a plan that begins anew knows no way back.
            if self._session.procedure.capture.strategy != "planned":
                first = self._session.state.poses_here[0].number
                doubted += f" Automatic capture reads pose {first} again first, which tells."
            self._publisher.say(Level.WARNING, doubted)

    def captured(self, pose: CapturedPose) -> None:
        """Say what there is now."""
        self.refresh()
        noise = READING_SD(float(pose.sd_rad.max())).with_unit
        self._publisher.say(Level.INFO, f"pose {pose.number} captured (noise up to {noise})")

    def automatic(self) -> None:
        """Take the poses that are left, as they come or by a plan; any key ends it."""
        try:
            end = take_poses(self._session, self._listener)
        finally:
            self._publisher.publish(lambda s: replace(s, heading=None))
        self.refresh()
        if end is None:
            wanted = self._session.procedure.capture.poses
            self._publisher.say(Level.INFO, f"all {wanted} poses captured")
        else:
            level = Level.INFO if end.complete else Level.WARNING
            self._publisher.say(
                level, f"capture {'complete' if end.complete else 'ended'}: {end.text}"
            )

    def undo(self) -> None:
        """Take back what was done last: an exclusion, a note, else the last pose."""
        if self._edits and self._edits[-1].captured == self._session.state.captured:
            pose = self._edits.pop().before
            self._keep_for(self._undone, pose.number)
            self._as_before(pose)
            self.refresh()
            self._publisher.say(Level.INFO, f"the last change of pose {pose.number} taken back")
            return
        self._edits.clear()
        pose = self._session.undo()
        self._undone.append(
            _Edit(before=pose, captured=self._session.state.captured, taken_back=True)
        )
        self.refresh()
        self._publisher.say(Level.INFO, f"pose {pose.number} taken back")

    def redo(self) -> None:
        """Do again what was taken back last, unless something else was done since."""
        if not self._undone or self._undone[-1].captured != self._session.state.captured:
            raise GuardError("Nothing was taken back since the last change", "u takes back")
        last = self._undone.pop()
        number = last.before.number
        if last.taken_back:
            self._session.restore(number)
        else:
            self._keep_for(self._edits, number)
            self._as_before(last.before)
        self.refresh()
        self._publisher.say(Level.INFO, f"pose {number} is again as it was")

    def exclude(self, number: int) -> None:
        """Exclude a pose, or let it count again."""
        self._undone.clear()
        pose = self._keep_for(self._edits, number)
        if pose is not None and pose.excluded:
            self._session.include(number)
            self._publisher.say(Level.INFO, f"pose {number} counts again")
        else:
            self._session.exclude(number, "by the operator")
            self._publisher.say(Level.INFO, f"pose {number} excluded: it stays in the journal")
        self.refresh()

    def note(self, number: int, text: str) -> None:
        """Attach a note."""
        self._undone.clear()
        self._keep_for(self._edits, number)
        self._session.note(number, text)
        self.refresh()

    def _keep_for(self, edits: list[_Edit], number: int) -> CapturedPose | None:
        """Remember what a pose is like before it is edited."""
        state = self._session.state
        pose = next((p for p in state.poses if p.number == number), None)
        if pose is not None:
            edits.append(_Edit(before=pose, captured=state.captured))
        return pose

    def _as_before(self, pose: CapturedPose) -> None:
        now = next((p for p in self._session.state.poses if p.number == pose.number), pose)
        if now.note != pose.note:
            self._session.note(pose.number, pose.note)
        if now.excluded and not pose.excluded:
            self._session.include(pose.number)
        elif pose.excluded and not now.excluded:
            self._session.exclude(pose.number, pose.excluded)

    # -- 7 Export ----------------------------------------------------------------------------------

    def verify(self, poses: int, joints: tuple[int, ...]) -> None:
        """Verify with new poses, after setting the modes where `joints` says so; any key ends it."""
        if joints:
            self.set_modes(joints)
        self.results.verify(poses)

    # -- any time ----------------------------------------------------------------------------------

    def reset(self) -> None:
        """Clear STOP; the drives stay disabled."""
        self._session.reset_stop()
        if self._session.arm.snapshot().stopped:  # pressed again meanwhile
            return
        self._publisher.publish(lambda s: replace(s, stop=None))
        self._publisher.say(Level.INFO, "STOP reset: nothing moves; apply the modes again (step 3)")

    def heed(self) -> None:
        """Keep in the journal what the arm was stopped for while nothing was asked of it."""
        self._session.heed()

    def hold(self) -> None:
        """All joints to position mode where they are."""
        self._at(None)
        self._session.hold()
        self.refresh()

    def refresh(self) -> None:
        """Publish the session's state and what its poses are worth."""
        session = self._session
        state = session.state
        now = self._appraisal.of(state)
        if not state.solved:
            self.results.solution = None
        self._publisher.publish(
            lambda s: replace(
                s,
                state=state,
                live=now.live,
                next_waypoint=now.next_waypoint,
                best_waypoint=now.best_waypoint,
                solution=self.results.solution,
            )
        )

    # -- inside ------------------------------------------------------------------------------------

    def _foresee(self, plan: tuple[Mapping[int, float], ...], start_rad: FloatArray) -> None:
        self._appraisal.foresee(plan, start_rad)
        self._publisher.publish(lambda s: replace(s, plan=plan, forecast=self._appraisal.forecast))

    def _at(self, waypoint: int | None) -> None:
        """Say at which waypoint the arm is; None before it moves."""
        self._publisher.publish(lambda s: replace(s, at_waypoint=waypoint))


class _Publishing(Listener):
    """Shows how a capture goes on."""

    def __init__(self, operations: Operations, publisher: Publisher) -> None:
        self._operations, self._publisher = operations, publisher

    def going(self, move: GoTo | None) -> None:
        self._publisher.publish(lambda s: replace(s, at_waypoint=None, heading=move))

    def arrived(self, waypoint: int) -> None:
        self._publisher.publish(lambda s: replace(s, at_waypoint=waypoint))

    def pose_captured(self, state: SessionState, wanted: int) -> None:
        self._operations.captured(state.poses[-1])

    def told(self, text: str) -> None:
        self._publisher.say(Level.INFO, text)

"""What the worker does for the operator: each step's work on a session, publishing what it found.

Every function runs on the worker's thread and may block. Knows no thread and no screen.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.loop import loop_of_poses
from operator_app.calibration.placed import as_seen
from operator_app.calibration.solution import Solution
from operator_app.config.parameters_file import parse_parameters
from operator_app.errors import Cancelled, GuardError
from operator_app.planning.forecast import Forecast, most_telling, predict
from operator_app.planning.live import LiveQuality, live_quality
from operator_app.session.drives import choose_by_prediction
from operator_app.session.going_home import go_home
from operator_app.session.listener import Listener
from operator_app.session.parameter_diff import diff_rows
from operator_app.session.session import Session
from operator_app.session.snapshot import Change, Iteration, Level, Verified, Written
from operator_app.session.solving import Solver, SolvingProcess
from operator_app.session.state import CapturedPose, SessionState
from operator_app.session.wording import unwatching_words
from operator_app.session.workflow import take_poses, verify
from operator_app.units.figure import MOVED, READING_SD, SIGMA_POS
from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.design.actions import GoTo
from solver.design.drive_joints import RankedDrives, rank_at_pose
from solver.loops.closure import ClosureModel, poses_needed

WIGGLE_RAD = float(np.deg2rad(2.0))


class Publisher(Protocol):
    """Where operations put what they found, and hear that they should end."""

    def publish(self, change: Change) -> None:
        """Put the changed snapshot in the place of the present one."""
        ...

    def say(self, level: Level, text: str) -> None:
        """Tell the operator."""
        ...

    def cancelled(self) -> bool:
        """Whether the operator wants this ended."""
        ...


class Operations:
    """The work of the seven steps."""

    def __init__(self, session: Session, publisher: Publisher) -> None:
        self._session = session
        self._publisher = publisher
        self._listener = _Publishing(self, publisher)
        session.cancelled = publisher.cancelled
        session.told = lambda text: publisher.say(Level.INFO, text)
        self._forecast: Forecast | None = None
        self._placed: Fixture | None = None
        self._live: LiveQuality | None = None
        self._solution: Solution | None = None
        self._plan: tuple[Mapping[int, float], ...] = ()

    # -- 1 Connect, 2 Fixture ----------------------------------------------------------------------

    def connect_mounted(self) -> None:
        """Keep that the fixture is mounted, as somebody said, then connect."""
        self._session.mounted()
        self.connect()

    def connect(self) -> None:
        """Find the arm, or find it again; check it, and judge the fixture where the arm stands."""
        self._session.arm.close()
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
        if words := unwatching_words(identity):
            self._publisher.say(Level.WARNING, words)
        self._show_what_is_known()
        self.check_fixture()

    def _show_what_is_known(self) -> None:
        """Show the calibration of a resumed session, which is not solved again."""
        known = self._session.calibrated()
        if self._solution is None and known is not None:
            self._solution = known.solution
            self._publisher.publish(lambda s: replace(s, checks_of_it=known.checks))
            if known.solution.accepted:
                self._compare()

    def check_fixture(self) -> None:
        """Judge the placement, rank the drive joints, predict the plan."""
        session = self._session
        checks = session.check_fixture()
        here = session.arm.snapshot().positions_rad
        model = self._model
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
            self._foresee(session.plan(), start)
        elif len(joints) == session.mobility:
            self._foresee(session.plan_from(here, joints), here)
        self.refresh()

    def confirm(self, item: str, text: str) -> None:
        """Record what the operator has confirmed."""
        self._session.record("confirmed", {"item": item, "text": text})

    # -- 3 Modes -----------------------------------------------------------------------------------

    def set_modes(self, position_joints: tuple[int, ...]) -> None:
        """Take control, set the modes, read them back, and lay out the plan."""
        session = self._session
        session.set_modes(position_joints)
        names = " and ".join(f"J{j}" for j in position_joints)
        self._publisher.say(Level.INFO, f"{names} in position mode, the others free: read back")
        start = session.state.start_rad
        if start is not None:
            self._foresee(session.plan(), start)
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
        reached = self._session.visit(waypoint)
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
        """Take back the last pose."""
        pose = self._session.undo()
        self.refresh()
        self._publisher.say(Level.INFO, f"pose {pose.number} taken back")

    def exclude(self, number: int) -> None:
        """Exclude a pose, or let it count again."""
        pose = next((p for p in self._session.state.poses if p.number == number), None)
        if pose is not None and pose.excluded:
            self._session.include(number)
            self._publisher.say(Level.INFO, f"pose {number} counts again")
        else:
            self._session.exclude(number, "by the operator")
            self._publisher.say(Level.INFO, f"pose {number} excluded: it stays in the journal")
        self.refresh()

    def note(self, number: int, text: str) -> None:
        """Attach a note."""
        self._session.note(number, text)
        self.refresh()

    # -- 5 Calibrate -------------------------------------------------------------------------------

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
        self._solution = solution
        # All at once, and only now: what was said of an earlier calibration does not hold for this one.
        self._publisher.publish(
            lambda s: replace(
                s, solution=solution, checks_of_it=None, written=None, diff=(), receipt=None,
                verification=None, report=None,
            )
        )  # fmt: skip
        self.refresh()
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

    # -- 7 Export ----------------------------------------------------------------------------------

    def _compare(self) -> None:
        """Compare what would be written with what is active on the controller."""
        session, solution = self._session, self._judged()
        active_bytes = session.arm.active_parameters() if session.identity is not None else b""
        active = parse_parameters(active_bytes, "active parameters") if active_bytes else None
        rows = diff_rows(session.document(solution), active)
        self._publisher.publish(lambda s: replace(s, diff=rows))

    def write(self) -> None:
        """Write the session's files."""
        self._export(upload_too=False)

    def upload(self, forced: str = "") -> None:
        """Write the files, hold the arm, upload, read back; `forced` says why, if it was not accepted."""
        session = self._session
        session.hold()
        self._export(upload_too=True, forced=forced)

    def _export(self, *, upload_too: bool, forced: str = "") -> None:
        exported = self._session.export(self._judged(), upload_too=upload_too, forced=forced)
        digest = hashlib.sha256(exported.parameters.read_bytes()).hexdigest()
        written = Written(
            folder=exported.folder,
            parameters=exported.parameters,
            poses=exported.poses,
            sha256=digest,
        )
        self._publisher.publish(lambda s: replace(s, written=written))
        self.refresh()
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
        verdict, _ = verify(self._session, self._judged(), poses, self._listener)
        judged = verdict.verification
        turned = judged.sigmas.orientation_rad
        found = Verified(
            poses=verdict.poses,
            position_m=judged.sigmas.position_m.rms,
            orientation_rad=None if turned is None else turned.rms,
            chi2_per_dof=judged.chi2.per_dof,
            holds=verdict.holds,
        )
        self.refresh()
        self._publisher.publish(lambda s: replace(s, verification=found))
        self._publisher.say(
            Level.INFO,
            f"verified with {found.poses} new poses: {SIGMA_POS(found.position_m).with_unit} rms",
        )

    # -- any time ----------------------------------------------------------------------------------

    def reset(self) -> None:
        """Clear STOP; the drives stay disabled."""
        self._session.arm.reset_stop()
        self._publisher.publish(lambda s: replace(s, stop=None))
        self._publisher.say(Level.INFO, "STOP reset: nothing moves; apply the modes again (step 3)")

    def hold(self) -> None:
        """All joints to position mode where they are."""
        self._at(None)
        self._session.hold()
        self.refresh()

    def refresh(self) -> None:
        """Publish the session's state and what its poses are worth."""
        session = self._session
        state = session.state
        used = state.used_poses
        if used:
            q = np.array([p.mean_rad for p in used])
            numbers = tuple(p.number for p in used)
            model = self._model_of(state)
            self._live = live_quality(session.model, model, q, numbers, earlier=self._live)
        else:
            self._live = self._placed = None
        if not state.solved:
            self._solution = None
        plan = self._plan
        left = [k for k in range(len(plan)) if k not in state.visited]
        best = None
        known = self._live is not None and session.fixture.holds_hand
        if used and self._forecast is not None and left and known and self._live is not None:
            best = most_telling(
                session.model,
                self._model,
                self._live.x,
                taken_rad=np.array([p.mean_rad for p in used]),
                forecast=self._forecast,
                open_waypoints=left,
            )
        self._publisher.publish(
            lambda s: replace(
                s,
                state=state,
                live=self._live,
                next_waypoint=left[0] if left else None,
                best_waypoint=best,
                solution=self._solution,
            )
        )

    # -- inside ------------------------------------------------------------------------------------

    def _foresee(self, plan: tuple[Mapping[int, float], ...], start_rad: FloatArray) -> None:
        session, model = self._session, self._model
        x = nominal_vector(model.parameters)
        self._plan = plan
        self._forecast = predict(
            session.model,
            model,
            x,
            start_rad=start_rad,
            plan=plan,
            poses=session.procedure.capture.poses,
        )
        self._publisher.publish(lambda s: replace(s, plan=plan, forecast=self._forecast))

    def _at(self, waypoint: int | None) -> None:
        """Say at which waypoint the arm is; None before it moves."""
        self._publisher.publish(lambda s: replace(s, at_waypoint=waypoint))

    def _model_of(self, state: SessionState) -> ClosureModel:
        """The loop of all poses; an instrument's place is found once, when there are poses enough."""
        session = self._session
        if session.fixture.holds_hand:
            return self._model
        poses = state.pose_set()
        model = self._model
        needed = poses_needed(len(model.parameters), model.equations_per_pose)
        if self._placed is None and len(poses) >= needed:
            self._placed = as_seen(session.model, session.fixture, poses)
        return loop_of_poses(session.model, self._placed or session.fixture, poses)

    @property
    def _model(self) -> ClosureModel:
        return self._session.fixture.model(self._session.model)

    def _judged(self) -> Solution:
        if self._solution is None:
            raise GuardError("There is no calibration of these poses", "Calibrate first (step 5)")
        return self._solution


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

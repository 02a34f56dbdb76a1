"""The session: one calibration of one arm, deed by deed, every fact in the journal before it counts.

What is done with one, in which order, is `workflow`'s affair. It prints nothing and asks nothing;
refusals are `SessionError`s that say what happened and what to do. Calls come from one thread;
`state` and `arm.snapshot()` may be read from any.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from typing import Any

import numpy as np

from fixtures.base import SetupCheck, Severity
from hardware.arm import Arm, ArmIdentity, ArmSnapshot, JointMode, MoveResult, Reading, Watch
from hardware.errors import HardwareError, SensorFault
from hardware.objects import EmergencyCode
from hardware.trajectory import coming_to_rest_s
from operator_app.calibration.record import to_dict
from operator_app.calibration.refusals import FixtureRefusedError
from operator_app.calibration.solution import Solution
from operator_app.config.atomic import write_atomically
from operator_app.config.degrees import degrees_for_file
from operator_app.config.parameters_file import format_parameters
from operator_app.config.poses_file import save_poses
from operator_app.config.procedure import Procedure
from operator_app.errors import Cancelled, GuardError, JournalLostError, SessionError
from operator_app.planning.exploration import Box, box_of, overload, range_watch, waypoints
from operator_app.planning.held import held_checks
from operator_app.planning.mode_rule import modes_problem
from operator_app.session.export import (
    PARAMETERS_NAME,
    POSES_NAME,
    Exported,
    upload,
)
from operator_app.session.going_home import require_in_box
from operator_app.session.instrument import SOURCES, Instrument
from operator_app.session.journal import Clock, Journal, utc_now
from operator_app.session.logbook import Logbook
from operator_app.session.sameness import (
    check_counters,
    check_identity,
    check_return,
    check_standing,
    read_alike,
    require_moving,
)
from operator_app.session.state import CapturedPose, CheckReading
from operator_app.session.wording import by_hand_words
from solver.arrays import FloatArray

STARTING_SYNCS = 20
STANDS_STILL_RAD = float(np.deg2rad(0.2))
"""A move that ends within a fifth of a second, this near to where it began, has not begun."""


class Session(Logbook):
    """A calibration session on one arm.

    Attributes
    ----------
    cancelled
        Asked while the arm moves: True when the operator wants that ended.
    told
        Hears what a person is to do with an arm that is moved by hand.
    """

    def __init__(
        self,
        *,
        journal: Journal,
        arm: Arm,
        procedure: Procedure,
        instrument: Instrument | None = None,
        clock: Clock = utc_now,
    ) -> None:
        super().__init__(journal=journal, procedure=procedure, clock=clock)
        self.arm = arm
        self._instrument = instrument
        self.identity: ArmIdentity | None = None
        self.cancelled: Callable[[], bool] = lambda: False
        self.told: Callable[[str], None] = lambda _: None
        self._same = False
        self._read_until = -1
        self._let_go = False

    def record(self, name: str, data: Mapping[str, Any]) -> None:
        """Write an event and let it count.

        Where the journal was taken away the arm is held: nothing more of it would be kept.
        """
        try:
            super().record(name, data)
        except JournalLostError:
            self._hold_if_possible()
            raise

    # -- 1 Connect -------------------------------------------------------------------------------

    def connect(self) -> ArmIdentity:
        """Find the arm. A resumed session insists on the arm it was begun with.

        Before it the instrument, where one sees the hand: without it nothing need be enabled.
        """
        self._require_mounted()
        self._require_instrument()
        identity = self.arm.connect()
        self._same = False
        try:
            check_identity(self.state, identity)
        except GuardError:
            # Not left connected: nothing of this session may move another arm.
            self.identity = None
            self.arm.close()
            raise
        self.identity = identity
        self.record(
            "connected",
            {
                "model": identity.model,
                "serial_number": identity.serial_number,
                "nodes": [asdict(node) for node in identity.nodes],
            },
        )
        return identity

    def mounted(self) -> None:
        """Keep that somebody said the fixture is mounted, in a placement of which nothing else is known."""
        if self.state.unseen:
            self.record("remounted", {"placement": self.state.placement})

    def _require_mounted(self) -> None:
        """Connect to no arm at whose fixture somebody may be at work."""
        if not self.state.mounted:
            raise GuardError(
                f"the fixture was taken off, and nobody said that it is mounted for placement {self.state.placement}",
                "mount it, stand clear, then go on with the session: sarcal run --resume, or the app",
            )

    def _require_instrument(self) -> None:
        if self.fixture.holds_hand:
            return
        if self._instrument is None:
            raise SessionError(
                f"{self.procedure.fixture.name} measures where the hand is, and nobody said where its "
                "measurements come from",
                f"name its port: --tracker {SOURCES}; or tracker: in the procedure",
            )
        self._instrument.open()

    def clear_lost_heartbeat(self) -> tuple[int, ...]:
        """Reset drives that tripped for nothing but the loss of an operator's heartbeat; return them.

        Such a trip says that a program ended or froze, not that the arm met anything. The drives stay
        disabled. With any other trip among them, nothing is reset.
        """
        faults = self.arm.snapshot().faults
        if not faults or any(f.code != EmergencyCode.HEARTBEAT_LOST for f in faults):
            return ()
        self.arm.reset_stop()
        joints = tuple(sorted({f.joint for f in faults if f.joint is not None}))
        self.record("reset", {"joints": list(joints), "code": int(EmergencyCode.HEARTBEAT_LOST)})
        return joints

    # -- 2 Fixture -------------------------------------------------------------------------------

    def check_fixture(self) -> tuple[SetupCheck, ...]:
        """Judge the nominal placement at the arm's present pose."""
        checks = (
            *self.fixture.setup_checks(self.model, self.arm.snapshot().positions_rad),
            *held_checks(self.procedure),
        )
        self.record(
            "fixture_checked",
            {"checks": [{**asdict(c), "severity": c.severity.value} for c in checks]},
        )
        return checks

    def require_fixture(self) -> tuple[SetupCheck, ...]:
        """Like `check_fixture`; raises FixtureRefusedError when a check refuses the placement."""
        checks = self.check_fixture()
        refused = tuple(c for c in checks if c.severity is Severity.REFUSED)
        if refused:
            raise FixtureRefusedError(refused)
        return checks

    # -- 3 Modes ---------------------------------------------------------------------------------

    @property
    def mobility(self) -> int:
        """How many joints belong in position mode: all where nothing holds the hand."""
        if not self.fixture.holds_hand:
            return self.model.joint_count
        loop = self.fixture.model(self.model)
        return self.model.joint_count - loop.equations_per_pose

    def check_modes(self, position_joints: tuple[int, ...]) -> None:
        """Refuse a wrong number of position-mode joints, with the reason."""
        problem = modes_problem(
            position_joints,
            joint_count=self.model.joint_count,
            mobility=self.mobility,
            kind=self.fixture.kind,
        )
        if problem is not None:
            raise problem

    def set_modes(self, position_joints: tuple[int, ...]) -> None:
        """Take control, then position mode for these joints and free mode for the rest."""
        self.check_modes(position_joints)
        self.take_control()
        modes = tuple(
            JointMode.POSITION if j in position_joints else JointMode.FREE
            for j in range(1, self.model.joint_count + 1)
        )
        self.arm.set_modes(modes)
        self.record("modes", {"modes": [m.value for m in modes]})

    def hold(self) -> None:
        """All joints to position mode where they are."""
        self.arm.hold()
        self.record("modes", {"modes": [JointMode.POSITION.value] * self.model.joint_count})

    def take_control(self) -> None:
        """Enable the drives, holding; the first time, remember where the arm stood.

        Before that, the first time after connecting: is everything still what it was?
        """
        self._require_journal()
        self._require_the_same()
        self.arm.take_control()
        start = self.arm.capture(self.procedure.capture.samples_per_pose).mean_rad
        home = self.model.home_rad.tolist()
        self.record("control", {"start_rad": start.tolist(), "home_rad": home})

    def _require_the_same(self) -> None:
        """Refuse to enable drives of an arm, or in a fixture, that is not the one of the poses so far."""
        if self._same:
            return
        here = self.arm.capture(self.procedure.capture.samples_per_pose)
        check_counters(self.model, here.mean_counts)
        if self.state.poses_here:
            endpoint = self._measured({"kind": "standing", "number": self.state.captured}, here)
            found = check_standing(self.state, self.procedure, here, endpoint)
            self.record("standing", {"told": found.told, "probability": found.probability})
        self._same = True

    @property
    def position_joints(self) -> tuple[int, ...]:
        """Joints in position mode as last confirmed."""
        return tuple(j for j, m in enumerate(self.state.modes, 1) if m == JointMode.POSITION.value)

    # -- 4 Capture -------------------------------------------------------------------------------

    def plan(self) -> tuple[Mapping[int, float], ...]:
        """All waypoints of this session, visited ones included."""
        own = self.procedure.capture
        return waypoints(self.box(), poses=own.poses, seed=own.seed)

    def plan_from(
        self, start_rad: FloatArray, joints: tuple[int, ...]
    ) -> tuple[Mapping[int, float], ...]:
        """Waypoints of these drive joints in a session that would begin at `start_rad` (n,)."""
        own, home = self.procedure.capture, self.model.home_rad
        box = box_of(self.model, own, joints, home_rad=home, start_rad=start_rad)
        return waypoints(box, poses=own.poses, seed=own.seed)

    def verification_plan(self, poses: int) -> tuple[Mapping[int, float], ...]:
        """Waypoints elsewhere than those of the plan, others for every verification."""
        seed = self.procedure.capture.seed + 1 + self.state.verifications
        return waypoints(self.box(), poses=poses, seed=seed)

    def box(self) -> Box:
        """Where the joints in position mode may be taken."""
        state = self.state
        if state.start_rad is None or state.home_rad is None or not self.position_joints:
            raise GuardError("the joint modes are not set", "set the modes first (step 3)")
        return box_of(
            self.model,
            self.procedure.capture,
            self.position_joints,
            home_rad=state.home_rad,
            start_rad=state.start_rad,
        )

    def go_to(
        self,
        targets_rad: Mapping[int, float],
        also: Watch | None = None,
        *,
        speed_rad_per_s: float | None = None,
    ) -> MoveResult:
        """Move the position-mode joints, watching every joint; `also` may end the move as well.

        Refused when not exactly as many joints are in position mode as the chain has freedoms: held
        joints would work against each other through the fixture.

        Raises
        ------
        Cancelled
            The operator ended it.
        """
        self.check_modes(self.position_joints)
        self._raise_if_cancelled()
        self._require_journal()
        speed = self.procedure.capture.speed_rad_per_s
        if speed_rad_per_s is not None:
            speed = min(speed, speed_rad_per_s)
        unplanned = also is None
        in_range = range_watch(self.model, coming_to_rest_s(speed) if unplanned else 0.0)
        if self.identity is not None and self.identity.by_hand:
            self.told(by_hand_words(targets_rad))

        def watch(snapshot: ArmSnapshot) -> str | None:
            if self.cancelled():
                return "ended by the operator"
            return in_range(snapshot) or (None if also is None else also(snapshot))

        with self._heeding_sensors():
            moved = self.arm.move(
                targets_rad,
                speed_rad_per_s=speed,
                watch=watch,
            )
        self._raise_if_cancelled()
        return moved

    def reach(self, targets_rad: Mapping[int, float]) -> MoveResult:
        """Go there; what stops the arm lies ahead, so that it goes back the way it came."""
        before = self.arm.snapshot().positions_rad
        moved = self.go_to(targets_rad)
        if not moved.reached:
            back = self.go_to({j: float(before[j - 1]) for j in targets_rad})
            still = float(np.abs(back.positions_rad - before).max()) < STANDS_STILL_RAD
            loaded = overload(self.model, self.arm.snapshot())
            if loaded and still and not back.reached and moved.syncs <= STARTING_SYNCS:
                # Not this target's affair: no other could be reached either.
                raise GuardError(
                    f"the arm cannot begin to move: {moved.reason}",
                    "look at what holds or pushes it, and at that joint's drive; no waypoint was "
                    "passed over: go on with this session then",
                )
        return moved

    def visit(self, index: int) -> bool:
        """Go to a waypoint; one that cannot be reached is passed over (False)."""
        require_in_box(self)
        moved = self.reach(self.plan()[index])
        if not moved.reached:
            self.record("waypoint_skipped", {"waypoint": index, "reason": moved.reason})
        return moved.reached

    def capture(
        self, waypoint: int = -1, note: str = "", *, planned: bool | None = None
    ) -> CapturedPose:
        """Let the arm settle, read a pose, and keep it; `planned` says a campaign's plan chose it."""
        campaign = {} if planned is None else {"planned": planned}
        number = self.state.captured + 1
        self._keep("pose", {"number": number, "waypoint": waypoint, "note": note, **campaign})
        return self.state.poses[-1]

    def look_again(self, kind: str, *, of: int = 0) -> CheckReading:
        """Like `capture`, of a pose that checks the calibration instead of making it."""
        self._keep("reading", {"number": len(self.state.readings) + 1, "kind": kind, "of": of})
        return self.state.readings[-1]

    def require_same_return(self) -> str:
        """Refuse to go on when the pose that was read again does not read as it did; what else it says."""
        told = check_return(self.state, self.procedure)
        self.record("return_holds", {"of": self.state.returns[-1].first.number, "told": told})
        return told

    @contextmanager
    def _heeding_sensors(self) -> Iterator[None]:
        """Keep what a sensor did that it should not; a pose that was read meanwhile does not count."""
        try:
            yield
        except SensorFault as fault:
            self.record("sensor_fault", {"joint": fault.joint, "text": str(fault)})
            for number in self._read_wrong(fault):
                self.exclude(number, f"joint {fault.joint} read wrong by then")
            raise

    def _read_wrong(self, fault: SensorFault) -> tuple[int, ...]:
        """Numbers of the poses that do not count for what a sensor did."""
        if fault.stuck:
            return read_alike(self.state, self.procedure.arm, fault.joint)
        if fault.since_sync is None or fault.since_sync > self._read_until:
            return ()
        return tuple(pose.number for pose in self.state.poses[-1:])

    def _keep(self, name: str, data: Mapping[str, Any]) -> None:
        """Read a pose and record it."""
        self.check_modes(self.position_joints)
        if name == "pose" and self.state.slipped:
            raise GuardError(
                f"no pose is captured: {self.state.slipped}",
                "let the capture go on by itself: it reads the first pose again, and goes on if that reads "
                "as it did; else start a new session",
            )
        reading = self.read()
        with self._heeding_sensors():
            require_moving(self.state, self.procedure, reading)
        endpoint = self._measured(data, reading)
        self.record(
            name,
            {
                **data,
                **({"placement": self.state.placement} if self.state.placement > 1 else {}),
                **({} if endpoint is None else {"endpoint": endpoint.tolist()}),
                # The angles a poses file can hold, so that poses.csv is these very poses.
                "mean_rad": np.deg2rad(degrees_for_file(reading.mean_rad)).tolist(),
                "sd_rad": np.deg2rad(degrees_for_file(reading.sd_rad)).tolist(),
                "samples": reading.samples,
                "first_sync": reading.first_sync,
            },
        )

    def _measured(self, data: Mapping[str, Any], reading: Reading) -> FloatArray | None:
        """Where the instrument sees the hand, the arm standing as it was read; None without one."""
        if self.fixture.holds_hand or self._instrument is None:
            return None
        what = f"{data.get('kind', '')} {data['number']}".strip()
        found = self._instrument.measure(what, self.cancelled)
        if found is None:
            raise Cancelled
        moved = np.abs(self.arm.snapshot().positions_rad - reading.mean_rad)
        if np.any(moved > self.procedure.capture.settle.spread_rad(self.model)):
            raise GuardError(
                f"joint {int(np.argmax(moved)) + 1} moved while the tracker measured",
                "see what moves or pushes the arm, then capture again",
            )
        return found

    def read(self) -> Reading:
        """Let the arm settle and read a pose, without keeping it."""
        if not self.settle():
            raise GuardError(
                "the arm does not come to rest",
                "look for something that moves or pushes it, then capture again",
            )
        with self._heeding_sensors():
            reading = self.arm.capture(self.procedure.capture.samples_per_pose)
        self._read_until = self.arm.snapshot().sync_count
        return reading

    def settle(self) -> bool:
        """Wait until it has come to rest; False if it does not. A capture insists on it, a move need not."""
        rule = self.procedure.capture.settle
        with self._heeding_sensors():
            return self.arm.settle(
                window=rule.window_syncs,
                spread_rad=rule.spread_rad(self.model),
                timeout_syncs=rule.timeout_syncs,
            )

    # -- 7 Export --------------------------------------------------------------------------------

    def export(
        self, solution: Solution, *, upload_too: bool | None = None, forced: str = ""
    ) -> Exported:
        """Write the session's files and upload the parameters, unless the procedure says not to.

        A calibration that was not accepted is refused, but for a reason: `forced`. It is kept in the
        journal and in the file, for whoever finds these parameters on the controller one day.
        """
        if not solution.accepted and not forced:
            raise GuardError(
                f"the calibration was not accepted: {'; '.join(solution.reasons)}",
                "see what it asks for; or say why it is to be used all the same (--force REASON)",
            )
        forced = "" if solution.accepted else forced
        if to_dict(solution) != self.state.solution:
            # Made otherwise than the journal's: whoever reads it later finds what was exported.
            self._record_solution(solution)
        poses = self.state.pose_set()
        document = self.document(solution, forced=forced)
        folder = self.journal.path.parent
        save_poses(folder / POSES_NAME, poses)
        data = format_parameters(document)
        write_atomically(folder / PARAMETERS_NAME, data)
        receipt = None
        if self.procedure.upload if upload_too is None else upload_too:
            counts = tuple(joint.home_offset_counts for joint in document.joints)
            receipt = upload(self.arm, data, counts)
        self.record(
            "exported",
            {
                "file": PARAMETERS_NAME,
                "sha256": hashlib.sha256(data).hexdigest(),
                "uploaded": None if receipt is None else asdict(receipt),
                "forced": forced,
            },
        )
        return Exported(
            folder=folder,
            parameters=folder / PARAMETERS_NAME,
            poses=folder / POSES_NAME,
            receipt=receipt,
        )

    # -- end -------------------------------------------------------------------------------------

    def close(self, reason: str) -> bool:
        """Leave the arm held and the journal whole. Safe to call twice; False if it did not answer."""
        try:
            self._let_go = self.arm.close()
            return self._let_go
        finally:
            if self._instrument is not None:
                self._instrument.close()
            try:
                if not self.journal.closed and self.journal.loss is None:
                    # Who closes it looks at the journal's loss, which may come to light here.
                    with suppress(JournalLostError):
                        self.record("closed", {"reason": reason})
            finally:
                self.journal.close()

    def require_let_go(self) -> None:
        """Refuse to send anybody to the fixture of an arm of which nobody knows what it does.

        Raises
        ------
        SessionError
            The arm did not answer when the session was closed.
        """
        if not self._let_go:
            raise SessionError(
                "the arm did not answer when it was told to hold and let go: nobody here knows what it does",
                "look before you go near; its drives hold by themselves when they miss the operator's heartbeat",
            )

    def _require_journal(self) -> None:
        """Move nothing for a session whose journal is gone."""
        try:
            self.journal.require_there()
        except JournalLostError:
            self._hold_if_possible()
            raise

    def _hold_if_possible(self) -> None:
        with suppress(HardwareError):
            self.arm.hold()

    def _raise_if_cancelled(self) -> None:
        if self.cancelled():
            raise Cancelled

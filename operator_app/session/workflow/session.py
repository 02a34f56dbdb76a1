"""The operations of a session on its arm: connect, set modes, move, capture, release.

Prints nothing and asks nothing; refusals are `SessionError`s with a remedy. All calls come from one thread; `state`
and `arm.snapshot()` may be read from any thread.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import cached_property
from typing import Any

from fixtures.base import SetupCheck, Severity
from fixtures.setup_checks import setup_checks
from hardware.arm import (
    NO_LATENCY,
    ArmIdentity,
    ArmSnapshot,
    JointMode,
    MoveResult,
    PowerReporting,
    Watch,
)
from hardware.control.trajectory import coming_to_rest_s
from hardware.errors import HardwareError
from operator_app.calibration.experiment import FixtureRefusedError
from operator_app.errors import (
    Cancelled,
    DrivesNotOffError,
    GuardError,
    JournalError,
    JournalLostError,
)
from operator_app.messages.errors import by_hand_words
from operator_app.planning.drives import modes_problem
from operator_app.planning.exploration import range_watch
from operator_app.planning.task import fixed_parameter_checks
from operator_app.session.safety.preflight import require_plausible_readings
from operator_app.session.safety.resume_checks import check_counters, check_identity
from operator_app.session.safety.sensor_faults import require_no_sensor_fault
from operator_app.session.store.journal import Journal
from operator_app.session.store.logbook import Logbook
from operator_app.session.store.state import CapturedPose, CheckReading
from operator_app.session.workflow.opening import Rig
from operator_app.session.workflow.pose_reading import PoseReader
from operator_app.session.workflow.remounting import require_mounted


class Session(Logbook):
    """A calibration session on one arm.

    `rig`: the arm and what belongs to it. `reader`: measures the poses.
    `cancelled`: function that returns whether the operator has cancelled; called during moves and measurements.
    `instruct`: function that shows instructions to the person who moves the arm by hand.
    `unresolved_joints`: joints (1-based) for which the last check of the readings could not have detected a shift.
    `held`: whether the arm confirmed, at the last `release_holding`, that no drive follows commands any longer.
    """

    def __init__(self, rig: Rig, journal: Journal) -> None:
        super().__init__(journal, rig.opening.procedure, rig.truths)
        self.rig, self.arm = rig, rig.arm
        self.reader = PoseReader(self, rig.arm, rig.instrument, self.raise_if_cancelled)
        self.identity: ArmIdentity | None = None
        self.cancelled: Callable[[], bool] = lambda: False
        self.instruct: Callable[[str], None] = lambda _: None
        self._connected = self._reconnected = self._readings_checked = False
        self.unresolved_joints: tuple[int, ...] = ()
        self.held = False
        self._powered: tuple[int, ...] = ()

    def record(self, name: str, data: Mapping[str, Any]) -> None:
        """Record an event in journal and state; if the journal is lost, hold the arm and raise JournalLostError."""
        with self._holding_if_journal_is_lost():
            super().record(name, data)

    # -- 1 Connect -------------------------------------------------------------------------------

    def connect(self, *, measuring: bool = True) -> ArmIdentity:
        """Connect to the arm and return its identity; raises GuardError if it is not the session's arm.

        First opens the instrument that measures an open arm, unless `measuring` is false, e.g. for an upload.
        """
        require_mounted(self.state)
        if measuring:
            self.reader.open_instrument()
        identity = self.arm.connect()
        self._reconnected = self._reconnected or self._connected
        self._connected, self._readings_checked = True, False
        self.reader.recorded_latency = NO_LATENCY
        try:
            check_identity(self.state, identity)
        except GuardError:
            # The session must not stay connected to the wrong arm.
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
                **({"configured": list(identity.configured)} if identity.configured else {}),
            },
        )
        return identity

    def mounted(self) -> None:
        """Record the operator's confirmation that the fixture is mounted.

        Does nothing in the first placement, or if the placement already has used poses.
        """
        if self.state.unconfirmed_placement:
            self.record("remounted", {"placement": self.state.placement})

    # -- 2 Fixture -------------------------------------------------------------------------------

    def check_fixture(self) -> tuple[SetupCheck, ...]:
        """Check the nominal placement of the fixture at the current pose, and record the checks."""
        checks = (
            *setup_checks(self.fixture, self.model, self.arm.snapshot().positions_rad),
            *fixed_parameter_checks(self.procedure),
        )
        self.record("fixture_checked", {"checks": [c.data for c in checks]})
        return checks

    def require_fixture(self) -> tuple[SetupCheck, ...]:
        """Call `check_fixture` and return its checks; raise FixtureRefusedError if one of them refuses the fixture."""
        checks = self.check_fixture()
        refused = tuple(c for c in checks if c.severity is Severity.REFUSED)
        if refused:
            raise FixtureRefusedError(refused)
        return checks

    # -- 3 Modes ---------------------------------------------------------------------------------

    @cached_property
    def mobility(self) -> int:
        """Number of joints to put into position mode: the chain's degrees of freedom; for an open arm, all joints."""
        if not self.fixture.holds_hand:
            return self.model.joint_count
        return self.model.joint_count - self.fixture.model(self.model).equations_per_pose

    def check_modes(self, position_joints: tuple[int, ...]) -> None:
        """Raise GuardError if these joints are not a valid set for position mode."""
        problem = modes_problem(
            position_joints,
            joint_count=self.model.joint_count,
            mobility=self.mobility,
            kind=self.fixture.kind,
        )
        if problem is not None:
            raise problem

    def set_modes(self, position_joints: tuple[int, ...]) -> None:
        """Enable the drives, and set position mode for these joints and free mode for the others."""
        self.check_modes(position_joints)
        self.take_control()
        modes = tuple(
            JointMode.POSITION if j in position_joints else JointMode.FREE
            for j in range(1, self.model.joint_count + 1)
        )
        self.arm.set_modes(modes)
        self.record("modes", {"modes": [m.value for m in modes]})

    def hold(self) -> None:
        """Put all joints into position mode; they hold their current positions."""
        self.arm.hold()
        self.record("modes", {"modes": [JointMode.POSITION.value] * self.model.joint_count})

    def take_control(self) -> None:
        """Enable the drives in position mode, and record the joint angles of the present position and of the home.

        Before enabling, the first call after each connection checks the readings and refuses implausible ones.
        """
        self.require_journal()
        self._check_readings()
        self.arm.take_control()
        start = self.arm.capture(self.procedure.capture.samples_per_pose).mean_rad
        home = self.model.home_rad.tolist()
        self.record("control", {"start_rad": start.tolist(), "home_rad": home})

    def _check_readings(self) -> None:
        """Call `require_plausible_readings`, once for each connection to the arm."""
        if self._readings_checked:
            return
        reading = self.arm.capture(self.procedure.capture.samples_per_pose)
        what = f"standing {self.state.captured}"
        self.unresolved_joints = require_plausible_readings(
            self, reading, lambda: self.reader.endpoint(what, reading)
        )
        self._readings_checked = True

    def require_counters_of_poses(self) -> None:
        """Before an upload, raise GuardError if counters or sensors may have changed since the poses were captured.

        After connecting again, also checks the readings, once for each connection, and refuses implausible ones.
        """
        check_counters(self.model, self.arm.snapshot().positions_rad)
        require_no_sensor_fault(self.state, "an upload is refused")
        if self._reconnected:
            self._check_readings()

    # -- 4 Capture -------------------------------------------------------------------------------

    def go_to(
        self,
        targets_rad: Mapping[int, float],
        path_watch: Watch | None = None,
        *,
        speed_rad_per_s: float | None = None,
    ) -> MoveResult:
        """Move joints in position mode to the angles `targets_rad`, by joint; return the result of the move.

        The move ends early if a joint is overloaded, too fast or near a range end, or `path_watch` returns a reason.
        Raises Cancelled if the operator ended the move, and GuardError if not `mobility` joints are in position mode.
        """
        self.check_modes(self.state.position_joints)
        self.raise_if_cancelled()
        self.require_journal()
        speed = self.procedure.capture.speed_rad_per_s
        if speed_rad_per_s is not None:
            speed = min(speed, speed_rad_per_s)
        in_range = range_watch(self.model, coming_to_rest_s(speed) if path_watch is None else 0.0)
        if self.identity is not None and self.identity.by_hand:
            self.instruct(by_hand_words(targets_rad))

        def watch(snapshot: ArmSnapshot) -> str | None:
            if self.cancelled():
                return "ended by the operator"
            return in_range(snapshot) or (None if path_watch is None else path_watch(snapshot))

        with self.reader.sensor_faults.recorded():
            outcome = self.arm.move(targets_rad, speed_rad_per_s=speed, watch=watch)
        self.raise_if_cancelled()
        return outcome

    def capture(self, waypoint: int = -1, *, planned: bool | None = None) -> CapturedPose:
        """Wait for standstill, measure a pose and record it.

        `waypoint`: index of the waypoint at which the arm is; -1 if it is at none. `planned`: whether a plan chose the
        pose; None outside a planned capture.
        """
        campaign = {} if planned is None else {"planned": planned}
        number = self.state.captured + 1
        self._keep("pose", {"number": number, "waypoint": waypoint, **campaign})
        return self.state.poses[-1]

    def take_check_reading(self, kind: str, *, of: int = 0) -> CheckReading:
        """Measure and record a check reading, `kind` ``verification`` or ``return`` (repeat of pose number `of`)."""
        self._keep("reading", {"number": len(self.state.readings) + 1, "kind": kind, "of": of})
        return self.state.readings[-1]

    def reset_stop(self) -> None:
        """Clear STOP and drive faults after recording why the arm was stopped; the drives stay disabled.

        Raises JournalError, and clears nothing, if the journal cannot be written. Raises Stopped if STOP was pressed
        again, DriveFault if a fault cannot be cleared, and BusError if the bus fails.
        """
        with suppress(HardwareError):
            self.reader.sensor_faults.record_stop_cause()
        self.arm.reset_stop()

    def _keep(self, name: str, data: Mapping[str, Any]) -> None:
        self.check_modes(self.state.position_joints)
        self.reader.keep(name, data)

    # -- end -------------------------------------------------------------------------------------

    def release_holding(self) -> None:
        """Hold the arm, switch its drives off and release control; set `held` according to the arm's confirmation.

        First records host latency and why the arm has stopped, because neither is available after the release.
        """
        try:
            if not self.journal.closed and self.journal.loss is None:
                with suppress(HardwareError):
                    self.reader.sensor_faults.record_stop_cause()
                with suppress(HardwareError):
                    self.reader.record_latency()
        finally:
            self.held = self.arm.close()
            self._powered = self.arm.left_powered if isinstance(self.arm, PowerReporting) else ()
            self.identity = None

    def close(self, reason: str) -> None:
        """Hold the arm, switch its drives off, release control, close instrument and journal. May be called twice."""
        try:
            # If `release_holding` cannot write to the journal, neither can `record` below, which raises the error.
            with suppress(JournalError):
                self.release_holding()
        finally:
            self.reader.close_instrument()
            try:
                if not self.journal.closed and self.journal.loss is None:
                    # The caller reports a loss detected here, from `journal.loss`.
                    with suppress(JournalLostError):
                        self.record("closed", {"reason": reason})
                        self.require_journal(unchanged=True)
            finally:
                self.journal.close()

    @property
    def not_held(self) -> DrivesNotOffError | None:
        """Error stating that drives may still follow commands; None if the arm confirmed the opposite."""
        return None if self.held else DrivesNotOffError(self._powered)

    def require_drives_off(self) -> None:
        """Raise DrivesNotOffError unless all drives are known to be off; only then may the fixture be touched."""
        if self._powered or not self.held:
            raise DrivesNotOffError(self._powered)

    def require_journal(self, *, unchanged: bool = False) -> None:
        """If the journal is lost, hold the arm and raise JournalLostError; `unchanged`: a changed line counts too."""
        with self._holding_if_journal_is_lost():
            super().require_journal(unchanged=unchanged)

    @contextmanager
    def _holding_if_journal_is_lost(self) -> Iterator[None]:
        try:
            yield
        except JournalLostError:
            with suppress(HardwareError):
                self.arm.hold()
            raise

    def raise_if_cancelled(self) -> None:
        """Raise Cancelled if the operator has cancelled."""
        if self.cancelled():
            raise Cancelled

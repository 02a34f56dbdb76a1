"""The session: one calibration of one arm, deed by deed, every fact in the journal before it counts.

What is done with one, in which order, is `workflow`'s affair. It prints nothing and asks nothing;
refusals are `SessionError`s that say what happened and what to do. Calls come from one thread;
`state` and `arm.snapshot()` may be read from any.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from typing import Any

from fixtures.base import SetupCheck, Severity
from hardware.arm import (
    Arm,
    ArmIdentity,
    ArmSnapshot,
    HostLatency,
    JointMode,
    MoveResult,
    PowerReporting,
    Reading,
    Watch,
)
from hardware.control.trajectory import coming_to_rest_s
from hardware.errors import HardwareError
from operator_app.calibration.refusals import FixtureRefusedError
from operator_app.config.procedure import Procedure
from operator_app.errors import (
    Cancelled,
    GuardError,
    JournalError,
    JournalLostError,
    NotLetGoError,
)
from operator_app.messages.errors import by_hand_words
from operator_app.planning.exploration import range_watch
from operator_app.planning.fixed_parameters import held_checks
from operator_app.planning.mode_rule import modes_problem
from operator_app.session.safety.latency import LatenessLog
from operator_app.session.safety.preflight import require_standing
from operator_app.session.safety.resume_checks import check_identity
from operator_app.session.safety.sensor_faults import SensorFaults
from operator_app.session.store.journal import Clock, Journal, utc_now
from operator_app.session.store.logbook import Logbook
from operator_app.session.store.state import CapturedPose, CheckReading
from operator_app.session.workflow.instrument import Instrument
from operator_app.session.workflow.placements import require_mounted
from operator_app.session.workflow.pose_reading import PoseReader


class Session(Logbook):
    """A calibration session on one arm.

    Attributes
    ----------
    cancelled
        Called while the arm moves: True when the operator wants the motion to end.
    told
        Called with instructions to the person who moves the arm by hand.
    unseen
        Joints (1-based) of which a shift since the last pose would not show at the present pose.
    held
        Whether the arm confirmed at the last `let_go` that no drive follows commands any more.
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
        self._sensor_faults = SensorFaults(self, arm)
        self._lateness = LatenessLog(self, arm)
        self._reader = PoseReader(
            self,
            arm,
            sensor_faults=self._sensor_faults,
            lateness=self._lateness,
            instrument=instrument,
        )
        self.identity: ArmIdentity | None = None
        self.cancelled: Callable[[], bool] = lambda: False
        self.told: Callable[[str], None] = lambda _: None
        self._same = False
        self.unseen: tuple[int, ...] = ()
        self.held = False
        self._powered: tuple[int, ...] = ()

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
        require_mounted(self.state)
        self._reader.open_instrument()
        identity = self.arm.connect()
        self._same = False
        self._lateness.begin()
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
                **({"configured": list(identity.configured)} if identity.configured else {}),
            },
        )
        return identity

    def mounted(self) -> None:
        """Keep that somebody said the fixture is mounted, in a placement of which nothing else is known."""
        if self.state.unseen:
            self.record("remounted", {"placement": self.state.placement})

    # -- 2 Fixture -------------------------------------------------------------------------------

    def check_fixture(self) -> tuple[SetupCheck, ...]:
        """Judge the nominal placement at the arm's present pose."""
        checks = (
            *self.fixture.setup_checks(self.model, self.arm.snapshot().positions_rad),
            *held_checks(self.procedure),
        )
        self.record(
            "fixture_checked",
            {"checks": [c.data for c in checks]},
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

    @cached_property
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
        self.require_journal()
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
        what = f"standing {self.state.captured}"
        self.unseen = require_standing(
            self, here, lambda: self._reader.endpoint(what, here, self.cancelled)
        )
        self._same = True

    @property
    def position_joints(self) -> tuple[int, ...]:
        """Joints in position mode as last confirmed."""
        return self.state.position_joints

    # -- 4 Capture -------------------------------------------------------------------------------

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
        self.require_journal()
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

        with self._sensor_faults.kept():
            moved = self.arm.move(
                targets_rad,
                speed_rad_per_s=speed,
                watch=watch,
            )
        self._raise_if_cancelled()
        return moved

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

    def heed(self) -> None:
        """Keep, and raise, what the arm was stopped for by itself while nothing was asked of it."""
        self._sensor_faults.heed()

    def reset_stop(self) -> None:
        """Clear STOP and what tripped, once the journal says why the arm was stopped; the drives stay disabled.

        Raises
        ------
        JournalError
            The journal cannot be written: nothing was cleared.
        Stopped, DriveFault, BusError
            As `Arm.reset_stop`.
        """
        with suppress(HardwareError):
            self._sensor_faults.heed()
        self.arm.reset_stop()

    def _keep(self, name: str, data: Mapping[str, Any]) -> None:
        self.check_modes(self.position_joints)
        self._reader.keep(name, data, self.cancelled)

    def read(self) -> Reading:
        """Let the arm settle and read a pose, without keeping it."""
        return self._reader.read()

    def settle(self) -> bool:
        """Wait until it has come to rest; False if it does not. A capture insists on it, a move need not."""
        return self._reader.settle()

    @property
    def late_here(self) -> HostLatency:
        """How late this computer was, of the present connection or the last, as the journal has it."""
        return self._lateness.kept

    # -- end -------------------------------------------------------------------------------------

    def let_go(self) -> bool:
        """Leave the arm held, to connect again; False if it is not held.

        Why it was stopped and how late this computer was go into the journal first: only the arm knows them.
        """
        try:
            if not self.journal.closed and self.journal.loss is None:
                with suppress(HardwareError):
                    self._sensor_faults.heed()
                with suppress(HardwareError):
                    self._lateness.record()
        finally:
            self.held = self.arm.close()
            self._powered = self.arm.left_powered if isinstance(self.arm, PowerReporting) else ()
            self.identity = None
        return self.held

    def close(self, reason: str) -> bool:
        """Leave the arm held and the journal whole. Safe to call twice; False if it is not held."""
        try:
            # What cannot be written is said by the last entry, which cannot be either.
            with suppress(JournalError):
                self.let_go()
            return self.held
        finally:
            self._reader.close_instrument()
            try:
                if not self.journal.closed and self.journal.loss is None:
                    # Who closes it looks at the journal's loss, which may come to light here.
                    with suppress(JournalLostError):
                        self.record("closed", {"reason": reason})
                        self.require_journal(unchanged=True)
            finally:
                self.journal.close()

    @property
    def not_held(self) -> NotLetGoError | None:
        """Why nobody may say that the arm is held, now that it was let go of; None where it is."""
        return None if self.held else NotLetGoError(self._powered)

    def require_let_go(self) -> None:
        """Refuse to send anybody to the fixture of an arm whose drives are not known to be off."""
        if self._powered or not self.held:
            raise NotLetGoError(self._powered)

    def require_journal(self, *, unchanged: bool = False) -> None:
        """Move nothing for a session whose journal is gone: the arm is held."""
        try:
            super().require_journal(unchanged=unchanged)
        except JournalLostError:
            self._hold_if_possible()
            raise

    def _hold_if_possible(self) -> None:
        with suppress(HardwareError):
            self.arm.hold()

    def _raise_if_cancelled(self) -> None:
        if self.cancelled():
            raise Cancelled

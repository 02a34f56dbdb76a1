"""One virtual drive: states, modes, limits and trips; by example, then under random frames and events."""

import math
from collections.abc import Callable

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from hardware.arm import DriveState, JointMode
from hardware.canopen.cia402 import StatusBit
from hardware.canopen.objects import EmergencyCode
from hardware.virtual.drive import Drive
from tests.oracles.virtual_rig import axes

S, E = DriveState, EmergencyCode
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, DISABLE, RESET = 0x06, 0x07, 0x0F, 0x02, 0x00, 0x80
CSP, CST = 8, 10
ENCODER, RVDT = axes()[0], axes()[6]
STEP = ENCODER.limits.max_step_counts


class DriveBench:
    """A drive with a log of its error codes (`NONE`: all clear) and sensor values set by the test."""

    def __init__(self, axis=ENCODER, *, counts: int = 100) -> None:  # type: ignore[no-untyped-def]
        self.error_log: list[EmergencyCode] = []
        self.drive = Drive(
            axis, set(), on_emergency=lambda e: self.error_log.append([E.NONE, *e][-1])
        )
        self.counts, self.torque_nm, self.speed = counts, 0.0, 0.0
        self.drive.in_control = True
        self.run()

    def run(self, periods: int = 1) -> None:
        for _ in range(periods):
            self.drive.read(self.counts, self.torque_nm, self.speed)

    def enable(self, mode: int = CSP) -> Drive:
        for word in (SHUTDOWN, SWITCH_ON, ENABLE):
            self.drive.obey(word, self.counts, mode)
        self.run(4)
        assert self.drive.state is S.OPERATION_ENABLED
        return self.drive


@pytest.fixture
def bench():
    return DriveBench()


@pytest.fixture
def enabled(bench):
    return bench.enable()


@pytest.mark.parametrize("word", [QUICK_STOP, DISABLE, SHUTDOWN, SWITCH_ON])
def test_without_token_target_is_ignored_and_stop_is_obeyed(enabled, word):
    enabled.in_control = False
    enabled.obey(ENABLE, 101, CSP)
    assert enabled.target_counts == 100
    enabled.obey(word, 100, CSP)
    assert enabled.state is not S.OPERATION_ENABLED


def test_mode_switch_takes_its_cycles_and_restarts_on_new_request(bench, enabled):
    enabled.obey(ENABLE, 100, CST)
    bench.run(ENCODER.mode_switch_cycles - 1)
    enabled.obey(ENABLE, 100, CSP)
    enabled.obey(ENABLE, 100, CST)
    bench.run(ENCODER.mode_switch_cycles - 1)
    assert enabled.mode is JointMode.POSITION
    assert enabled.command()[0] is JointMode.POSITION
    bench.run()
    assert enabled.mode is JointMode.FREE
    assert enabled.command()[0] is JointMode.FREE


@pytest.mark.parametrize("code", [0, 1, 3, 9, -1])
def test_unsupported_mode_is_never_entered(bench, enabled, code):
    enabled.obey(ENABLE, 100, code)
    bench.run(50)
    assert enabled.mode is JointMode.POSITION


def test_entering_position_mode_resets_target_to_position(bench):
    drive = bench.enable(CST)
    bench.counts = 900
    bench.run()
    drive.obey(ENABLE, 100, CSP)  # an old target, 800 counts away
    bench.run(3)
    assert drive.mode is JointMode.POSITION
    assert drive.target_counts == 900


def test_enabling_resets_target_to_position(bench, enabled):
    enabled.obey(DISABLE, 100, CSP)
    bench.counts = 700
    bench.run()
    for word in (SHUTDOWN, SWITCH_ON, ENABLE):
        enabled.obey(word, 100, CSP)
    assert (enabled.target_counts, bench.error_log) == (700, [E.REFERENCE_LIMIT])


def test_target_step_is_limited(bench, enabled):
    enabled.obey(ENABLE, 100 + STEP, CSP)
    assert enabled.target_counts == 100 + STEP
    assert enabled.command()[1] == pytest.approx((100 + STEP) / 36000 * math.tau)
    enabled.obey(ENABLE, 100 + 2 * STEP + 1, CSP)
    assert (enabled.target_counts, bench.error_log) == (100 + STEP, [E.REFERENCE_LIMIT])
    assert enabled.statusword & StatusBit.INTERNAL_LIMIT
    assert enabled.state is S.OPERATION_ENABLED
    enabled.obey(ENABLE, 100 + 2 * STEP, CSP)
    assert enabled.target_counts == 100 + 2 * STEP
    assert bench.error_log == [E.REFERENCE_LIMIT, E.NONE]
    assert not enabled.statusword & StatusBit.INTERNAL_LIMIT


@pytest.mark.parametrize(("word", "target"), [(ENABLE, 100), (DISABLE, 9000), (SWITCH_ON, 9000)])
def test_reference_limit_error_ends_when_target_is_withdrawn(bench, enabled, word, target):
    enabled.obey(ENABLE, 9000, CSP)
    assert bench.error_log == [E.REFERENCE_LIMIT]
    enabled.obey(word, target, CSP)
    assert (bench.error_log, enabled.errors) == ([E.REFERENCE_LIMIT, E.NONE], [])


def test_target_range_ends_at_607dh():
    drive = DriveBench(counts=5999).enable()
    for target in (6000, 6001):
        drive.obey(ENABLE, target, CSP)
        assert drive.target_counts == 6000


@pytest.mark.parametrize("tripped", [False, True], ids=["off", "tripped"])
def test_lost_heartbeat_does_not_power_an_unpowered_drive(bench, tripped):
    if tripped:
        bench.enable().trip(E.EXCESS_TORQUE)
    bench.drive.lose_heartbeat()
    bench.run(2)
    assert bench.drive.state is S.FAULT
    assert bench.drive.command()[0] is None


WINDOW = ENCODER.following_window_counts
SPEED = ENCODER.limits.max_speed_rad_per_s
LOW, HIGH = RVDT.lowest_counts, RVDT.highest_counts


@pytest.mark.parametrize(
    ("mode", "quantity", "last_valid", "invalid", "cycles", "code"),
    [
        (
            CSP,
            "torque_nm",
            100.0,
            math.nextafter(100.0, math.inf),
            ENCODER.trip_cycles,
            E.EXCESS_TORQUE,
        ),
        (
            CSP,
            "torque_nm",
            -100.0,
            -math.nextafter(100.0, math.inf),
            ENCODER.trip_cycles,
            E.EXCESS_TORQUE,
        ),
        (CSP, "counts", 100 + WINDOW, 101 + WINDOW, ENCODER.trip_cycles, E.FOLLOWING),
        *(
            (mode, "speed", -SPEED, -math.nextafter(SPEED, 9.0), 1, E.OVERSPEED)
            for mode in (CSP, CST)
        ),
        # A converter at its end, also of a drive that is off.
        (None, "counts", LOW + 1, LOW, 1, E.SENSOR),
        (None, "counts", HIGH - 1, HIGH, 1, E.SENSOR),
    ],
)
def test_drive_trips_after_its_cycles_beyond_a_limit(
    mode, quantity, last_valid, invalid, cycles, code
):
    bench = DriveBench(RVDT if code is E.SENSOR else ENCODER)
    drive = bench.drive if mode is None else bench.enable(mode)
    before = drive.state
    for value, periods in ((last_valid, 20), (invalid, cycles - 1)):
        setattr(bench, quantity, value)
        bench.run(periods)
        assert drive.state is before
    bench.run()
    assert drive.state is S.FAULT_REACTION_ACTIVE
    assert drive.command()[0] is None
    bench.run()
    assert drive.state is S.FAULT
    assert bench.error_log == [code]
    assert bool(drive.statusword & StatusBit.FOLLOWING_ERROR) is (code is E.FOLLOWING)


def test_intermittent_excess_torque_does_not_trip(bench, enabled):
    for _ in range(10):
        bench.torque_nm = 150.0
        bench.run(ENCODER.trip_cycles - 1)
        bench.torque_nm = 0.0
        bench.run()
    assert enabled.state is S.OPERATION_ENABLED


def test_unpowered_drive_does_not_trip_on_torque_or_speed(bench):
    bench.torque_nm, bench.speed = 1e4, 1e4
    bench.run(10)
    assert bench.drive.state is S.SWITCH_ON_DISABLED


def test_constant_reset_bit_resets_once(bench):
    drive = bench.drive
    for after_reset in (S.SWITCH_ON_DISABLED, S.FAULT):
        drive.trip(E.EXCESS_TORQUE)
        drive.obey(RESET, 0, CSP)
        assert drive.state is after_reset


class RandomInputs(RuleBasedStateMachine):
    """Random frames and events: commands and targets of the drive stay within its rules."""

    def __init__(self) -> None:
        super().__init__()
        self.bench = DriveBench()
        self.drive = self.bench.drive
        self.last_target = self.drive.target_counts

    @rule(
        word=st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x8F]) | st.integers(0, 0xFFFF),
        target_counts=st.integers(-7000, 7000) | st.integers(60, 140),
        mode=st.sampled_from([0, 1, 8, 10]),
    )
    def receive_rpdo(self, word: int, target_counts: int, mode: int) -> None:
        self.drive.obey(word, target_counts, mode)

    @rule(torque=st.sampled_from([0.0, 50.0, 120.0]), drift=st.integers(-20, 20))
    def run_period(self, torque: float, drift: int) -> None:
        mode, target_rad = self.drive.command()
        if mode is JointMode.POSITION:
            self.bench.counts = round(target_rad * 36000 / math.tau)
        elif mode is JointMode.FREE:
            self.bench.counts += drift
        self.bench.torque_nm = torque
        self.bench.run()

    @rule(token=st.booleans())
    def set_token(self, token: bool) -> None:
        self.drive.in_control = token
        if not token:
            self.drive.quick_stop()

    @rule(event=st.sampled_from([Drive.lose_heartbeat, Drive.quick_stop]))
    def lose_heartbeat_or_stop(self, event: Callable[[Drive], None]) -> None:
        event(self.drive)

    @invariant()
    def joint_is_driven_only_if_enabled_or_holding(self) -> None:
        mode = self.drive.command()[0]
        if mode is JointMode.FREE:
            assert self.drive.state is S.OPERATION_ENABLED
        if self.drive.state in (S.SWITCH_ON_DISABLED, S.READY_TO_SWITCH_ON, S.SWITCHED_ON):
            assert mode is None

    @invariant()
    def target_changes_by_allowed_steps_or_to_position(self) -> None:
        step = abs(self.drive.target_counts - self.last_target)
        assert step <= STEP or self.drive.target_counts == self.drive.counts
        self.last_target = self.drive.target_counts

    @invariant()
    def errors_agree_with_state(self) -> None:
        drive = self.drive
        in_fault = drive.state in (S.FAULT, S.FAULT_REACTION_ACTIVE)
        # A refused target is no fault.
        assert bool(set(drive.errors) - {E.REFERENCE_LIMIT}) == in_fault
        assert len(drive.errors) == len(set(drive.errors))
        if drive.errors:
            assert self.bench.error_log[-1] is not E.NONE


TestRandomInputs = RandomInputs.TestCase
TestRandomInputs.settings = settings(max_examples=60, stateful_step_count=40)

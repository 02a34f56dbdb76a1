import math

import pytest

from hardware.arm import JointMode
from hardware.canopen.cia402 import StatusBit
from tests.hardware.virtual.drive_bench import (
    CSP,
    CST,
    DISABLE,
    ENABLE,
    ENCODER,
    QUICK_STOP,
    RESET,
    SHUTDOWN,
    STEP,
    SWITCH_ON,
    Bench,
    E,
    S,
)
from tests.oracles.virtual_rig import axes

RVDT = axes()[6]


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def enabled(bench):
    """The bench's drive, enabled in position mode."""
    return bench.enabled()


@pytest.mark.parametrize("word", [QUICK_STOP, DISABLE, SHUTDOWN, SWITCH_ON])
def test_stopping_never_needs_the_token(enabled, word):
    enabled.in_control = False
    enabled.obey(word, 100, CSP)
    assert enabled.state is not S.OPERATION_ENABLED


def test_targets_are_refused_without_the_token(enabled):
    enabled.in_control = False
    enabled.obey(ENABLE, 101, CSP)
    assert enabled.target_counts == 100


def test_a_mode_is_reached_after_its_cycles_and_not_before(bench, enabled):
    enabled.obey(ENABLE, 100, CST)
    bench.run(ENCODER.mode_switch_cycles - 1)
    assert enabled.mode is JointMode.POSITION
    assert enabled.command().mode is JointMode.POSITION
    bench.run()
    assert enabled.mode is JointMode.FREE
    assert enabled.command().mode is JointMode.FREE


def test_a_change_of_mind_starts_the_switch_again(bench, enabled):
    enabled.obey(ENABLE, 100, CST)
    bench.run(ENCODER.mode_switch_cycles - 1)
    enabled.obey(ENABLE, 100, CSP)
    enabled.obey(ENABLE, 100, CST)
    bench.run(ENCODER.mode_switch_cycles - 1)
    assert enabled.mode is JointMode.POSITION


@pytest.mark.parametrize("code", [0, 1, 3, 9, -1])
def test_a_mode_the_drive_has_not_is_never_reached(bench, enabled, code):
    enabled.obey(ENABLE, 100, code)
    bench.run(50)
    assert enabled.mode is JointMode.POSITION


def test_entering_position_mode_starts_where_the_joint_is(bench):
    drive = bench.enabled(CST)
    bench.counts = 900
    bench.run()
    drive.obey(ENABLE, 100, CSP)  # an old target, 800 counts away
    bench.run(3)
    assert drive.mode is JointMode.POSITION
    assert drive.target_counts == 900


def test_enabling_starts_where_the_joint_is(bench):
    bench.enabled()
    bench.drive.obey(DISABLE, 100, CSP)
    bench.counts = 700
    bench.run()
    drive = bench.drive
    for word in (SHUTDOWN, SWITCH_ON, ENABLE):
        drive.obey(word, 100, CSP)
    assert drive.target_counts == 700
    assert bench.said == [E.REFERENCE_LIMIT]


def test_targets_up_to_the_largest_step_are_taken(bench, enabled):
    enabled.obey(ENABLE, 100 + STEP, CSP)
    assert enabled.target_counts == 100 + STEP
    assert enabled.command().target_rad == pytest.approx((100 + STEP) / 36000 * math.tau)
    enabled.obey(ENABLE, 100 + 2 * STEP + 1, CSP)
    assert enabled.target_counts == 100 + STEP
    assert bench.said == [E.REFERENCE_LIMIT]
    assert enabled.flags & StatusBit.INTERNAL_LIMIT
    assert enabled.state is S.OPERATION_ENABLED
    enabled.obey(ENABLE, 100 + 2 * STEP, CSP)
    assert enabled.target_counts == 100 + 2 * STEP
    assert bench.said == [E.REFERENCE_LIMIT, E.NONE]
    assert not enabled.flags & StatusBit.INTERNAL_LIMIT


@pytest.mark.parametrize(("word", "target"), [(ENABLE, 100), (DISABLE, 9000), (SWITCH_ON, 9000)])
def test_a_refused_target_is_forgiven_when_taken_back(bench, enabled, word, target):
    enabled.obey(ENABLE, 9000, CSP)
    assert bench.said == [E.REFERENCE_LIMIT]
    enabled.obey(word, target, CSP)
    assert bench.said == [E.REFERENCE_LIMIT, E.NONE]
    assert enabled.errors == []


def test_the_range_ends_where_607dh_says():
    bench = Bench(counts=5999)
    drive = bench.enabled()
    drive.obey(ENABLE, 6000, CSP)
    assert drive.target_counts == 6000
    drive.obey(ENABLE, 6001, CSP)
    assert drive.target_counts == 6000


@pytest.mark.parametrize("tripped", [False, True], ids=["off", "tripped"])
def test_a_lost_heartbeat_powers_no_drive_that_was_off_or_tripped(bench, tripped):
    if tripped:
        bench.enabled().trip(E.EXCESS_TORQUE)
    bench.drive.lose_heartbeat()
    bench.run(2)
    assert bench.drive.state is S.FAULT
    assert bench.drive.command().mode is None


@pytest.mark.parametrize("sign", [1, -1])
def test_excess_torque_trips_after_its_cycles_just_above_the_limit(bench, enabled, sign):
    bench.torque_nm = sign * 100.0
    bench.run(20)
    assert enabled.state is S.OPERATION_ENABLED
    bench.torque_nm = sign * math.nextafter(100.0, math.inf)
    bench.run(ENCODER.trip_cycles - 1)
    assert enabled.state is S.OPERATION_ENABLED
    bench.run()
    assert enabled.state is S.FAULT_REACTION_ACTIVE
    assert enabled.command().mode is None
    bench.run()
    assert enabled.state is S.FAULT
    assert bench.said == [E.EXCESS_TORQUE]


def test_torque_that_comes_and_goes_does_not_trip(bench, enabled):
    for _ in range(10):
        bench.torque_nm = 150.0
        bench.run(ENCODER.trip_cycles - 1)
        bench.torque_nm = 0.0
        bench.run()
    assert enabled.state is S.OPERATION_ENABLED


def test_following_error_trips_just_outside_its_window(bench, enabled):
    bench.counts = 100 + ENCODER.following_window_counts
    bench.run(20)
    assert enabled.state is S.OPERATION_ENABLED
    bench.counts += 1
    bench.run(ENCODER.trip_cycles)
    assert bench.said == [E.FOLLOWING]
    assert enabled.flags & StatusBit.FOLLOWING_ERROR


def test_a_free_joint_has_no_following_error(bench):
    drive = bench.enabled(CST)
    for _ in range(50):
        bench.counts += 100
        bench.run()
    assert drive.state is S.OPERATION_ENABLED


@pytest.mark.parametrize("mode", [CSP, CST])
def test_overspeed_trips_at_once_in_either_mode(bench, mode):
    drive = bench.enabled(mode)
    limit = ENCODER.limits.max_speed_rad_per_s
    bench.speed = -limit
    bench.run(5)
    assert drive.state is S.OPERATION_ENABLED
    bench.speed = -math.nextafter(limit, math.inf)
    bench.run()
    assert bench.said == [E.OVERSPEED]


def test_a_drive_that_is_off_minds_neither_torque_nor_speed(bench):
    bench.torque_nm, bench.speed = 1e4, 1e4
    bench.run(10)
    assert bench.drive.state is S.SWITCH_ON_DISABLED


@pytest.mark.parametrize("end", [RVDT.lowest_counts, RVDT.highest_counts])
def test_a_converter_at_its_end_is_a_failed_sensor(end):
    bench = Bench(RVDT)
    inside = end + (1 if end == RVDT.lowest_counts else -1)
    bench.counts = inside
    bench.run()
    assert bench.said == []
    bench.counts = end
    bench.run()
    assert bench.said == [E.SENSOR]


def test_a_reset_word_that_stays_set_resets_once(bench):
    drive = bench.drive
    drive.trip(E.EXCESS_TORQUE)
    drive.obey(RESET, 0, CSP)
    assert drive.state is S.SWITCH_ON_DISABLED
    drive.trip(E.EXCESS_TORQUE)
    drive.obey(RESET, 0, CSP)
    assert drive.state is S.FAULT

import math
import struct
from dataclasses import replace

import numpy as np
import pytest

from hardware import errors
from tests.hardware.control.canopen_arm.conftest import FREE, PER_RAD, POSITION, TWO_DRIVEN
from tests.hardware.fake_arm import JOINTS, FakeArmBus
from tests.oracles.profiles import sarcos


def test_take_control_enables_every_drive_at_its_position(arm, bus):
    before = [drive.counts for drive in bus.drives.values()]
    with pytest.raises(errors.CommandRefused, match="switch on disabled"):
        arm.set_modes(TWO_DRIVEN)
    arm.take_control()
    assert (bus.token, bus.statuses) == (127, {0x27})
    assert [drive.target for drive in bus.drives.values()] == before
    snapshot = arm.snapshot()
    assert snapshot.token == 127
    assert {joint.mode for joint in snapshot.joints} == {POSITION}


def enable_late(bus: FakeArmBus, joint: int, syncs: int) -> None:
    """Have a drive act on *enable operation* only after this many SYNCs, as one with a brake or precharging."""
    axis, at_sync = bus.drives[joint], bus.syncs + syncs
    prompt_rpdo = axis.rpdo

    def late_rpdo(data: bytes) -> None:
        if struct.unpack("<Hib", data)[0] != 0x0F or bus.syncs >= at_sync:
            prompt_rpdo(data)

    axis.rpdo = late_rpdo


def test_joint_sinking_before_enable_is_held_at_its_final_position(arm, bus):
    """The brake of joint 3 opens late, and meanwhile the joint sinks by some degrees."""
    axis = bus.drives[3]

    def sink(_sync: int) -> None:
        axis.counts -= 200 * (axis.status != 0x27)

    enable_late(bus, 3, 30)
    bus.on_sync = sink
    arm.take_control()
    counts_when_enabled = axis.counts
    assert 3000 - counts_when_enabled >= 30 * 200
    assert axis.status == 0x27
    assert abs(axis.target - counts_when_enabled) <= 200
    arm.set_modes([POSITION] * 7)
    assert abs(axis.counts - counts_when_enabled) <= 200


def test_drive_not_enabled_in_time_leaves_all_drives_off(arm, bus, approve):
    enable_late(bus, 3, 70)
    with pytest.raises(errors.DriveNotReady) as error:
        arm.take_control()
    assert (error.value.joint, error.value.state) == (3, "switched on")
    approve(str(error.value))
    assert bus.statuses == {0x40}
    arm.capture(100)  # beyond the time at which the drive acts
    assert bus.statuses == {0x40}
    with pytest.raises(errors.CommandRefused):
        arm.move({1: 0.1}, speed_rad_per_s=0.2)
    arm.take_control()
    assert bus.statuses == {0x27}


def test_statusword_explains_a_drive_that_cannot_be_enabled(arm, bus, approve):
    bus.drives[2].rpdo = lambda _data: None
    bus.inverted_bits[2] = 0x0210  # no voltage, local control
    with pytest.raises(errors.DriveNotReady) as error:
        arm.take_control()
    approve(str(error.value))


def test_profile_allows_more_time_for_enabling(connected, bus):
    arm = connected(profile=replace(sarcos(), enabling_timeout_s=0.8))
    enable_late(bus, 3, 70)
    arm.take_control()
    assert bus.statuses == {0x27}


def test_drive_that_stays_on_after_failed_enabling_is_named(arm, bus, approve):
    enable_late(bus, 3, 10_000)
    bus.drives[5].ignores = (0x0000,)
    with pytest.raises(errors.DriveNotReady) as error:
        arm.take_control()
    approve(str(error.value))
    assert {joint: drive.status for joint, drive in bus.drives.items() if drive.status != 0x40} == {
        5: 0x27
    }


@pytest.mark.parametrize(
    ("node", "code", "error"), [(4, 0x4210, errors.DriveFault), (16, 0x5441, errors.Stopped)]
)
def test_alarm_while_enabling_leaves_no_drive_enabled(arm, bus, node, code, error):
    """A supervisor's emergency counts as a stop, but stops no drive."""
    enable_late(bus, 3, 30)
    bus.at(20, lambda: (bus.trip if node in bus.drives else bus.emergency)(node, code))
    with pytest.raises(error, match="All drives have been switched off again"):
        arm.take_control()
    assert bus.statuses == ({0x40, 0x08} if node in bus.drives else {0x40})


@pytest.mark.parametrize("command", ["hold", "take_control"])
def test_free_joint_is_held_where_it_is_once_it_answers(driven, bus, command):
    """It moves while it misses the first SYNCs of the command."""
    start, axis = bus.syncs, bus.drives[3]

    def lose_answers(sync: int) -> None:
        bus.without_tpdo = {3} if sync <= start + 3 else set()
        axis.counts += 500 * (sync <= start + 3)

    bus.on_sync = lose_answers
    getattr(driven, command)()
    assert (axis.mode, axis.target, axis.counts) == (8, 4500, 4500)


@pytest.mark.parametrize("holder", [42, 127])
def test_token_or_heartbeat_of_another_operator_denies_control(arm, bus, holder):
    if holder == 42:
        bus.token = 42
    else:
        bus.inject(0x77F, b"\x05")
        arm.active_parameters()  # whose response comes after the heartbeat
    with pytest.raises(errors.ControlDenied) as denied:
        arm.take_control()
    assert denied.value.holder == holder
    assert bus.commands == []


@pytest.mark.parametrize("before_connecting", [True, False])
def test_drive_fault_without_emergency_denies_control(connected, bus, before_connecting):
    if before_connecting:
        bus.drives[4].status = 0x08
        arm = connected()
        (fault,) = arm.snapshot().faults
        assert (fault.node, fault.code) == (4, 0x8611)
    else:
        arm = connected()
        bus.drives[4].status = 0x08
    with pytest.raises(errors.DriveFault) as error:
        arm.take_control()
    assert (error.value.joint, error.value.code) == (4, 0x8611)


def test_unreached_mode_raises_mode_not_reached(arm, bus):
    arm.take_control()
    bus.drives[3].follows_mode = False
    with pytest.raises(errors.ModeNotReached) as error:
        arm.set_modes(TWO_DRIVEN)
    assert (error.value.joint, error.value.wanted, error.value.actual) == (3, "free", "position")


def test_refused_position_mode_leaves_all_other_joints_held(driven, bus):
    """Otherwise fewer joints than the chain needs would hold it, and the arm would sag."""
    bus.drives[4].follows_mode = False
    other_pair = [POSITION if joint in (4, 6) else FREE for joint in range(1, JOINTS + 1)]
    with pytest.raises(errors.ModeNotReached) as error:
        driven.set_modes(other_pair)
    assert (error.value.joint, error.value.wanted) == (4, "position")
    assert [drive.mode for drive in bus.drives.values()] == [8, 8, 8, 10, 8, 8, 8]


def test_hold_after_an_unknown_mode_sets_position_mode_and_current_position(driven, bus):
    with pytest.raises(ValueError, match="JointMode"):
        driven.set_modes([None] * JOINTS)
    assert [drive.mode for drive in bus.drives.values()] == [10, 8, 10, 10, 8, 10, 10]
    assert [joint.mode for joint in driven.snapshot().joints] == TWO_DRIVEN
    bus.drives[3].counts = 3456
    driven.hold()
    assert (bus.drives[3].target, {drive.mode for drive in bus.drives.values()}) == (3456, {8})


def test_missing_following_bit_raises_mode_not_reached(arm, bus):
    bus.not_following = set(bus.drives)
    arm.take_control()
    with pytest.raises(errors.ModeNotReached, match=r"joint 2 .* position .* bit 12") as error:
        arm.set_modes(TWO_DRIVEN)
    assert error.value.joint == 2
    assert "have the drive set that bit" in str(error.value)
    assert "arm-check" not in str(error.value)
    arm.hold()  # which does not need that bit
    assert {drive.mode for drive in bus.drives.values()} == {8}


@pytest.mark.parametrize(
    ("noisy_syncs", "settled", "syncs"), [(30, True, range(40, 42)), (1000, False, range(60, 61))]
)
def test_settle_waits_for_small_spread_until_timeout(driven, bus, noisy_syncs, settled, syncs):
    start = bus.syncs
    bus.drives[4].noise = lambda sync: 500 if sync < start + noisy_syncs and sync % 2 else 0
    bus.at(35, lambda: bus.without_tpdo.add(2))  # an incomplete sample does not count
    bus.at(36, bus.without_tpdo.clear)
    spread = [100 / PER_RAD] * JOINTS
    assert driven.settle(window=10, spread_rad=spread, timeout_syncs=60) is settled
    assert bus.syncs - start in syncs


def test_reading_has_mean_sd_and_count_of_samples(driven, bus):
    noise = [3, -1, 4, 1, -5, 9, -2, 6]
    start = bus.syncs
    bus.drives[6].noise = lambda sync: noise[(sync - start - 1) % len(noise)]
    reading = driven.capture(len(noise))
    values = np.array(noise) + 6000
    assert reading.samples == len(noise)
    assert reading.mean_counts[5] == values.mean()
    assert reading.mean_rad[5] == pytest.approx(values.mean() / PER_RAD, rel=1e-14)
    variance = sum((v - values.mean()) ** 2 for v in values) / (len(noise) - 1)
    assert reading.sd_rad[5] == pytest.approx(math.sqrt(variance) / PER_RAD, rel=1e-12)
    assert reading.sd_rad[0] == 0.0
    assert reading.first_sync == driven.snapshot().sync_count - len(noise) + 1
    assert np.all(driven.capture(1).sd_rad == 0.0)


@pytest.mark.parametrize("fault", ["without_tpdo", "doubling_tpdo"])
def test_incomplete_sample_is_excluded_from_reading(driven, bus, fault):
    start = bus.syncs
    bus.at(3, lambda: getattr(bus, fault).add(2))
    bus.at(4, lambda: getattr(bus, fault).clear())
    bus.drives[6].noise = lambda sync: 1000 * (sync == start + 3)
    reading = driven.capture(6)
    assert bus.syncs - start == 7
    assert (reading.mean_counts[5], reading.sd_rad[5]) == (6000, 0.0)


def test_snapshot_ages_are_never_negative(driven, monkeypatch):
    """Frames may arrive while a snapshot is being built."""
    connection = driven._connection
    clock = connection._clock

    def clock_before_a_capture() -> float:
        now_s = clock()
        driven.capture(2)
        return now_s

    monkeypatch.setattr(connection, "_clock", clock_before_a_capture)
    assert all(joint.age_s >= 0.0 for joint in driven.snapshot().joints)

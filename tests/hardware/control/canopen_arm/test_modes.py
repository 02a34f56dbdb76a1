"""Taking control and setting modes on a fake bus."""

import struct

import pytest

from hardware.errors import CommandRefused, ControlDenied, DriveFault, ModeNotReached
from tests.hardware.on_fake_bus import POSITION, TWO_DRIVEN


def test_take_control_enables_every_drive_at_its_position(arm, bus):
    before = [drive.counts for drive in bus.drives.values()]
    arm.take_control()
    assert bus.token == 127
    assert bus.statuses == {0x27}
    assert [drive.target for drive in bus.drives.values()] == before
    snapshot = arm.snapshot()
    assert snapshot.token == 127
    assert {joint.mode for joint in snapshot.joints} == {POSITION}


def test_joint_sinking_before_enable_is_held_at_its_final_position(arm, bus):
    """The brake of joint 3 opens late, and meanwhile the joint sinks by some degrees."""
    axis, opens_at_sync = bus.drives[3], bus.syncs + 30
    prompt_rpdo = axis.rpdo

    def late_rpdo(data: bytes) -> None:
        if struct.unpack("<Hib", data)[0] != 0x0F or bus.syncs >= opens_at_sync:
            prompt_rpdo(data)

    def sink(_sync: int) -> None:
        axis.counts -= 200 * (axis.status != 0x27)

    axis.rpdo, bus.on_sync = late_rpdo, sink
    arm.take_control()
    counts_when_enabled = axis.counts
    assert 3000 - counts_when_enabled >= 30 * 200
    assert axis.status == 0x27
    assert abs(axis.target - counts_when_enabled) <= 200
    arm.set_modes([POSITION] * 7)
    assert abs(axis.counts - counts_when_enabled) <= 200


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
    with pytest.raises(ControlDenied) as denied:
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
    with pytest.raises(DriveFault) as error:
        arm.take_control()
    assert (error.value.joint, error.value.code) == (4, 0x8611)


def test_unreached_mode_raises_mode_not_reached(arm, bus):
    arm.take_control()
    bus.drives[3].follows_mode = False
    with pytest.raises(ModeNotReached) as error:
        arm.set_modes(TWO_DRIVEN)
    assert (error.value.joint, error.value.wanted, error.value.actual) == (3, "free", "position")


def test_set_modes_requires_enabled_drives(arm):
    with pytest.raises(CommandRefused, match="switch on disabled"):
        arm.set_modes(TWO_DRIVEN)


def test_hold_sets_position_mode_and_current_position(driven, bus):
    assert [drive.mode for drive in bus.drives.values()] == [10, 8, 10, 10, 8, 10, 10]
    assert [joint.mode for joint in driven.snapshot().joints] == TWO_DRIVEN
    bus.drives[3].counts = 3456
    driven.hold()
    assert bus.drives[3].target == 3456
    assert {drive.mode for drive in bus.drives.values()} == {8}


def test_missing_following_bit_raises_mode_not_reached(arm, bus):
    bus.reports_following = False
    arm.take_control()
    with pytest.raises(ModeNotReached, match=r"joint 2 .* position .* bit 12") as error:
        arm.set_modes(TWO_DRIVEN)
    assert error.value.joint == 2
    assert "have the drive set that bit" in str(error.value)
    assert "arm-check" not in str(error.value)
    arm.hold()  # which does not need that bit
    assert {drive.mode for drive in bus.drives.values()} == {8}

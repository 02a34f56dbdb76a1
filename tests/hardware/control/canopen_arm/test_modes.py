"""Control and modes on a fake bus: taken where the arm stands, read back, and respected of others."""

import struct

import pytest

from hardware.errors import CommandRefused, ControlDenied, DriveFault, ModeNotReached
from tests.hardware.on_fake_bus import POSITION, TWO_DRIVEN, frames


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
    """The brake of joint 3 opens late, and its joint sinks meanwhile by some degrees."""
    axis, opens = bus.drives[3], bus.syncs + 30
    released = axis.rpdo

    def rpdo(data: bytes) -> None:
        word, target, mode = struct.unpack("<Hib", data)
        axis.heard.append((word, target, mode))
        if word != 0x0F or bus.syncs >= opens:
            released(data)

    def sink(_sync: int) -> None:
        axis.counts -= 200 * (axis.status != 0x27)

    axis.rpdo, bus.on_sync = rpdo, sink
    arm.take_control()
    sunk = axis.counts
    assert 3000 - sunk >= 30 * 200
    assert axis.status == 0x27
    assert abs(axis.target - sunk) <= 200
    arm.set_modes([POSITION] * 7)
    assert abs(axis.counts - sunk) <= 200


def test_token_of_another_holder_denies_control(arm, bus):
    bus.token = 42
    with pytest.raises(ControlDenied) as denied:
        arm.take_control()
    assert denied.value.holder == 42
    assert frames(bus, 0x200) == []


def test_late_operator_heartbeat_denies_control(arm, bus):
    bus.say(0x77F, b"\x05")
    arm.active_parameters()  # its answer came after the heartbeat
    with pytest.raises(ControlDenied):
        arm.take_control()


def test_a_faulted_drive_is_named_when_control_is_taken(arm, bus):
    bus.drives[4].status = 0x08
    with pytest.raises(DriveFault) as fault:
        arm.take_control()
    assert (fault.value.joint, fault.value.code) == (4, 0x8611)


def test_modes_are_read_back(driven, bus):
    assert [drive.mode for drive in bus.drives.values()] == [10, 8, 10, 10, 8, 10, 10]
    assert [joint.mode for joint in driven.snapshot().joints] == TWO_DRIVEN


def test_unreached_mode_raises_mode_not_reached(arm, bus):
    arm.take_control()
    bus.drives[3].follows_mode = False
    with pytest.raises(ModeNotReached) as late:
        arm.set_modes(TWO_DRIVEN)
    assert (late.value.joint, late.value.wanted, late.value.actual) == (3, "free", "position")


def test_set_modes_requires_enabled_drives(arm):
    with pytest.raises(CommandRefused, match="switch on disabled"):
        arm.set_modes(TWO_DRIVEN)


def test_hold_sets_target_to_current_position(driven, bus):
    bus.drives[3].counts = 3456
    driven.hold()
    assert bus.drives[3].target == 3456
    assert {drive.mode for drive in bus.drives.values()} == {8}


def test_missing_following_bit_raises_mode_not_reached(arm, bus):
    bus.says_it_follows = False
    arm.take_control()
    with pytest.raises(ModeNotReached, match=r"joint 2 .* position .* bit 12") as deaf:
        arm.set_modes(TWO_DRIVEN)
    assert deaf.value.joint == 2
    assert "have the drive set that bit" in str(deaf.value)
    assert "arm-check" not in str(deaf.value)
    arm.hold()  # holding asks for less
    assert {drive.mode for drive in bus.drives.values()} == {8}

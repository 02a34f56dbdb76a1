"""Drives that are disabled without an emergency, on a fake bus: named, not enabled again, the others stopped."""

import pytest

from hardware.control.canopen_arm import CanopenArm
from hardware.errors import BusError, CommandRefused, DriveDiverged, DriveDropout, DriveFault
from tests.hardware.control.canopen_arm.conftest import TWO_DRIVEN, drive, wait_for
from tests.hardware.fake_arm import JOINTS, FakeArmBus, capture_for_ever

SWITCHED_ON, READY, ENABLED, OFF, STOPPED = 0x23, 0x21, 0x27, 0x40, 0x07


def drop(bus: FakeArmBus, joint: int, *, after: int = 30, to: int = SWITCHED_ON) -> None:
    """Set the state of a drive once, some SYNCs from now."""
    bus.at(after, lambda: setattr(bus.drives[joint], "status", to))


def was_never_reenabled(words: list[int]) -> bool:
    """Whether the controlwords of an enabled drive only ever go down."""
    return words == sorted(words, reverse=True)


def settle_for_ever(arm: CanopenArm) -> None:
    while True:
        arm.settle(window=20, spread_rad=[1.0] * JOINTS, timeout_syncs=30)


def move_for_ever(arm: CanopenArm) -> None:
    while True:
        for angle in (0.1, 0.0):
            arm.move({2: angle}, speed_rad_per_s=0.5)


@pytest.mark.sample(4)
@pytest.mark.parametrize("operation", [capture_for_ever, settle_for_ever, move_for_ever])
@pytest.mark.parametrize("joint", [2, 3, 5, 7])
def test_dropout_ends_operation_and_drive_stays_disabled(driven, bus, operation, joint):
    driven.capture(20)
    drop(bus, joint)
    since = len(bus.sent)
    with pytest.raises(
        DriveDropout, match=rf"joint {joint}: the drive is in state 'switched on'"
    ) as dropout:
        operation(driven)
    assert dropout.value.joint == joint
    with pytest.raises(DriveDropout):
        capture_for_ever(driven)
    assert {j: drive.status for j, drive in bus.drives.items()} == {
        j: OFF if j == joint else STOPPED for j in bus.drives
    }
    words = bus.controlwords(joint, since)
    assert was_never_reenabled(words)
    assert words[-1] == 0x0000


@pytest.mark.sample(9)
@pytest.mark.parametrize("after", range(1, 10))
@pytest.mark.parametrize("state", [SWITCHED_ON, OFF, STOPPED])
def test_dropout_right_after_enabling_is_not_enabled_again(arm, bus, after, state):
    arm.take_control()
    drop(bus, 3, after=after, to=state)
    since = len(bus.sent)

    def go_on() -> None:
        arm.set_modes(TWO_DRIVEN)
        arm.capture(50)

    with pytest.raises(DriveDropout, match="joint 3: the drive is in"):
        go_on()
    assert bus.drives[3].status == (STOPPED if state == STOPPED else OFF)
    assert {bus.drives[j].status for j in (1, 2, 4, 5, 6, 7)} == {STOPPED}
    assert was_never_reenabled(bus.controlwords(3, since))


@pytest.mark.parametrize("state", [SWITCHED_ON, READY, OFF, STOPPED])
def test_dropout_during_enabling_ends_take_control(arm, bus, state):
    begun = bus.syncs

    def delay_joint_7(sync: int) -> None:
        if sync < begun + 30:
            bus.drives[7].status = SWITCHED_ON

    bus.on_sync = delay_joint_7
    drop(bus, 3, after=8, to=state)
    with pytest.raises(DriveDropout, match="joint 3: the drive is in"):
        arm.take_control()
    words = bus.controlwords(3)
    enabling = words.index(0x0F)
    assert words[:enabling] == [0x06, 0x07]
    assert was_never_reenabled(words[enabling:])
    assert ENABLED not in bus.statuses


def test_dropout_requires_reset_before_enabling(driven, bus):
    driven.capture(20)
    drop(bus, 3)
    with pytest.raises(DriveDropout):
        capture_for_ever(driven)
    for command in (driven.take_control, lambda: driven.move({5: 0.1}, speed_rad_per_s=0.5)):
        with pytest.raises((DriveDropout, CommandRefused)):
            command()
    assert ENABLED not in bus.statuses
    driven.reset_stop()
    assert bus.statuses == {OFF}
    drive(driven)
    assert driven.move({5: 0.1}, speed_rad_per_s=0.5).reached
    driven.capture(50)


def test_dropout_is_detected_while_idle(live, bus):
    begun = bus.syncs
    wait_for(lambda: bus.syncs > begun + 20)
    drop(bus, 3, after=10)
    wait_for(lambda: bus.drives[3].status == OFF)
    wait_for(lambda: {d.status for j, d in bus.drives.items() if j != 3} == {STOPPED})
    (fault,) = live.snapshot().faults
    assert (fault.joint, fault.node, fault.text) == (3, 3, "the drive is in state 'switched on'")
    with pytest.raises(DriveDropout, match="joint 3"):
        live.capture(1)
    assert live.close()
    assert bus.drives[3].status == OFF


def test_late_emergency_determines_fault_code(driven, bus):
    driven.capture(20)
    drop(bus, 5, to=0x08)
    bus.at(31, lambda: bus.trip(5, 0x8311))
    with pytest.raises(DriveFault, match="joint 5 tripped: excess torque"):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert {drive.mode for j, drive in bus.drives.items() if j != 5} == {8}


def test_cleared_following_bit_raises_drive_dropout(driven, bus):
    driven.capture(20)
    bus.not_following = {5}
    with pytest.raises(DriveDropout, match=r"joint 5: .* no longer follows .*bit 12"):
        capture_for_ever(driven)
    bus.not_following = set()
    driven.reset_stop()
    drive(driven)
    driven.capture(80)


def test_following_error_reported_by_the_drive_ends_a_reading(driven, bus, approve):
    """The joint's position shows nothing: the drive follows another target, or its window is narrow."""
    driven.capture(20)
    bus.inverted_bits[5] = 0x2800  # following error, internal limit
    with pytest.raises(DriveDropout) as dropout:
        capture_for_ever(driven)
    assert (dropout.value.joint, dropout.value.not_following) == (5, True)
    approve(str(dropout.value))


def test_divergence_takes_precedence_over_cleared_following_bit(driven, bus):
    driven.capture(20)
    bus.not_following = {5}
    bus.drives[5].noise = lambda _sync: 1600
    with pytest.raises(DriveDiverged, match=r"joint 5 is \+1600 counts from its target"):
        capture_for_ever(driven)
    assert bus.drives[5].status == OFF


def test_disconnected_node_is_named_rather_than_its_neighbours(driven, bus):
    """The other drives stop at once; the missing answers and heartbeat of the node show later."""
    driven.capture(20)

    def disconnect() -> None:
        bus.offline = {3}
        for axis in (d for j, d in bus.drives.items() if j != 3):
            axis.status = STOPPED

    bus.at(30, disconnect)
    with pytest.raises(BusError, match=r"has gone silent: .* from node 3"):
        move_for_ever(driven)

"""A drive whose enable goes, and no word of it: named, not switched on again, and the others stopped."""

import pytest

from hardware.control.canopen_arm import CanopenArm
from hardware.errors import BusError, CommandRefused, DriveDiverged, DriveDropout, DriveFault
from tests.hardware.fake_arm import JOINTS, FakeArmBus
from tests.hardware.on_fake_bus import TWO_DRIVEN, capture_for_ever, wait_for

SWITCHED_ON, READY, ENABLED, OFF, STOPPED = 0x23, 0x21, 0x27, 0x40, 0x07


def drop(bus: FakeArmBus, joint: int, *, after: int = 30, to: int = SWITCHED_ON) -> None:
    """Let a drive fall back, to *switched on* say, some SYNCs from now, once, and say nothing of it."""
    at = bus.syncs + after

    def happen(sync: int) -> None:
        if sync == at:
            bus.drives[joint].status = to

    bus.on_sync = happen


def settle_for_ever(arm: CanopenArm) -> None:
    while True:
        arm.settle(window=20, spread_rad=[1.0] * JOINTS, timeout_syncs=30)


def move_to_and_fro(arm: CanopenArm) -> None:
    while True:
        for angle in (0.1, 0.0):
            arm.move({2: angle}, speed_rad_per_s=0.5)


@pytest.mark.sample(4)
@pytest.mark.parametrize("doing", [capture_for_ever, settle_for_ever, move_to_and_fro])
@pytest.mark.parametrize("joint", [2, 3, 5, 7])
def test_dropout_ends_operation_and_drive_stays_disabled(
    driven, bus, doing, joint
):
    driven.capture(20)
    drop(bus, joint)
    since = len(bus.sent)
    with pytest.raises(
        DriveDropout, match=rf"joint {joint}: the drive is in state switched on"
    ) as told:
        doing(driven)
    assert told.value.joint == joint
    with pytest.raises(DriveDropout):
        capture_for_ever(driven)
    assert {j: drive.status for j, drive in bus.drives.items()} == {
        j: OFF if j == joint else STOPPED for j in bus.drives
    }
    words = bus.words(joint, since)
    assert words == sorted(words, reverse=True), "switched on again"
    assert words[-1] == 0x0000


@pytest.mark.sample(9)
@pytest.mark.parametrize("after", range(1, 10))
@pytest.mark.parametrize("state", [SWITCHED_ON, OFF, STOPPED])
def test_dropout_right_after_enabling_is_not_enabled_again(
    arm, bus, after, state
):
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
    words = bus.words(3, since)
    assert words == sorted(words, reverse=True), "switched on again"


@pytest.mark.parametrize("state", [SWITCHED_ON, READY, OFF, STOPPED])
def test_dropout_during_enabling_ends_take_control(arm, bus, state):
    begun = bus.syncs

    def happen(sync: int) -> None:
        if sync < begun + 30:
            bus.drives[7].status = SWITCHED_ON  # it takes longer
        if sync == begun + 8:
            bus.drives[3].status = state

    bus.on_sync = happen
    with pytest.raises(DriveDropout, match="joint 3: the drive is in"):
        arm.take_control()
    heard = [word for word, _, _ in bus.drives[3].heard]
    assert heard[: heard.index(0x0F)] == [0x06, 0x07]
    after = heard[heard.index(0x0F) :]
    assert after == sorted(after, reverse=True), "switched on again"
    assert ENABLED not in bus.statuses


def test_dropout_requires_reset_before_enabling(driven, bus):
    driven.capture(20)
    drop(bus, 3)
    with pytest.raises(DriveDropout):
        capture_for_ever(driven)
    for refused in (driven.take_control, lambda: driven.move({5: 0.1}, speed_rad_per_s=0.5)):
        with pytest.raises((DriveDropout, CommandRefused)):
            refused()
    assert ENABLED not in bus.statuses
    driven.reset_stop()
    assert bus.statuses == {OFF}
    driven.take_control()
    driven.set_modes(TWO_DRIVEN)
    assert driven.move({5: 0.1}, speed_rad_per_s=0.5).reached
    driven.capture(50)


def test_dropout_is_detected_while_idle(live, bus):
    begun = bus.syncs
    wait_for(lambda: bus.syncs > begun + 20)
    drop(bus, 3, after=10)
    wait_for(lambda: bus.drives[3].status == OFF)
    wait_for(lambda: {d.status for j, d in bus.drives.items() if j != 3} == {STOPPED})
    (fault,) = live.snapshot().faults
    assert (fault.joint, fault.node, fault.text) == (3, 3, "the drive is in state switched on")
    with pytest.raises(DriveDropout, match="joint 3"):
        live.capture(1)
    assert live.close()
    assert bus.drives[3].status == OFF


def test_late_emergency_determines_fault_code(driven, bus):
    driven.capture(20)
    start = bus.syncs

    def trip(sync: int) -> None:
        if sync == start + 30:
            bus.drives[5].status = 0x08
        elif sync == start + 31:
            bus.trip(5, 0x8311)

    bus.on_sync = trip
    with pytest.raises(DriveFault, match="joint 5 tripped: excess torque"):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert {drive.mode for j, drive in bus.drives.items() if j != 5} == {8}


def test_cleared_following_bit_raises_drive_dropout(driven, bus):
    driven.capture(20)
    bus.deaf = {5}
    with pytest.raises(DriveDropout, match=r"joint 5: .* no longer follows .*bit 12"):
        capture_for_ever(driven)
    bus.deaf = set()
    driven.reset_stop()
    driven.take_control()
    driven.set_modes(TWO_DRIVEN)
    driven.capture(80)


def test_divergence_takes_precedence_over_cleared_following_bit(driven, bus):
    driven.capture(20)
    bus.deaf = {5}
    bus.drives[5].noise = lambda _sync: 1600
    with pytest.raises(DriveDiverged, match=r"joint 5 is \+1600 counts from its target"):
        capture_for_ever(driven)
    assert bus.drives[5].status == OFF


def test_disconnected_node_is_named_rather_than_its_neighbours(driven, bus):
    """The others stop by themselves at once; that the node is missed, answers and heartbeat, shows later."""
    driven.capture(20)
    at = bus.syncs + 30

    def happen(sync: int) -> None:
        if sync == at:
            bus.dead = {3}
            for drive in (d for j, d in bus.drives.items() if j != 3):
                drive.status = STOPPED

    bus.on_sync = happen
    with pytest.raises(BusError, match=r"has gone silent: .* from node 3"):
        move_to_and_fro(driven)

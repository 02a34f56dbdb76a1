"""A drive that goes where it was not told to, on a fake bus: the arm is stopped by itself, and says why."""

import struct

import can
import pytest

from hardware.arm import JointMode
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import BusError, DriveDiverged, Stopped
from hardware.timing import Pace
from tests.hardware.fake_arm import JOINTS, FakeArmBus, FakeDrive
from tests.hardware.on_fake_bus import TWO_DRIVEN, capture_for_ever, frames, hasty, make, wait_for

FAR, WINDOW = 1600, 1111
"""Counts: how far it goes, and the degree that a drive without 6065h is allowed."""


def diverge(bus: FakeArmBus, joint: int) -> None:
    """Let a joint creep away from here, 20 counts a SYNC, whatever it is told while it has power."""
    bus.says_it_follows = True
    begun = bus.syncs
    bus.drives[joint].noise = lambda sync: min(20 * max(sync - begun, 0), FAR)


def creep_when_stopped(bus: FakeArmBus, *joints: int) -> None:
    """Let joints creep on from here though their drives are in quick stop, until they lose their power."""
    begun = bus.syncs
    for joint in joints:
        drive = bus.drives[joint]

        def creep(sync: int, drive: FakeDrive = drive) -> int:
            return 20 * max(sync - begun, 0) if drive.status == 0x07 else 0

        drive.noise = creep


def in_real_time(bus: FakeArmBus) -> CanopenArm:
    """Ten times as fast as an arm is: nothing is asked of it, and SYNCs go on."""
    timing = hasty(speed=10.0)
    arm = make(bus, pace=Pace.REAL_TIME, timing=timing)
    arm.connect()
    arm.take_control()
    arm.set_modes(TWO_DRIVEN)
    return arm


def words(bus: FakeArmBus, joint: int, since: int) -> list[int]:
    sent = [data for i, data in bus.sent[since:] if i == 0x200 + joint]
    return [struct.unpack("<Hib", data)[0] for data in sent]


def test_the_arm_is_stopped_and_the_drive_that_is_astray_loses_its_power(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    diverge(bus, 5)
    since = len(bus.sent)
    with pytest.raises(DriveDiverged, match=r"joint 5 is \+1\d\d\d counts from its target") as told:
        capture_for_ever(driven)
    assert WINDOW < told.value.counts <= FAR
    assert {j: drive.status for j, drive in bus.drives.items()} == {
        j: 0x40 if j == 5 else 0x07 for j in range(1, JOINTS + 1)
    }
    # It is never asked to hold while it has power: holding is what it does wrong.
    commands = words(bus, 5, since)
    assert commands[commands.index(0x0000) - 1] == 0x000F
    assert set(words(bus, 2, since)) == {0x000F, 0x0002}
    found = driven.snapshot()
    assert found.stopped
    assert found.stopped_for == str(told.value)


def test_whatever_is_asked_then_the_cause_is_said_and_not_that_stop_was_pressed(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    diverge(bus, 2)
    with pytest.raises(DriveDiverged):
        driven.move({5: 1.2}, speed_rad_per_s=0.2)
    begun = len(frames(bus, 0x200))
    for refused in (
        lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1),
        lambda: driven.capture(1),
        lambda: driven.set_modes(TWO_DRIVEN),
        driven.take_control,
        driven.hold,
    ):
        with pytest.raises(DriveDiverged, match="the arm has been stopped"):
            refused()
    later = [struct.unpack("<Hib", data)[0] for _, data in frames(bus, 0x200)[begun:]]
    assert set(later) <= {0x0000, 0x0002}


def test_it_is_seen_and_stopped_while_nobody_asks_for_anything(bus: FakeArmBus) -> None:
    arm = make(bus, pace=Pace.REAL_TIME)
    arm.connect()
    arm.take_control()
    arm.set_modes([JointMode.POSITION] * JOINTS)
    assert arm.snapshot().stopped_for == ""
    diverge(bus, 3)
    wait_for(lambda: arm.snapshot().stopped)
    assert "joint 3 is +1" in arm.snapshot().stopped_for
    wait_for(lambda: bus.drives[3].status == 0x40)
    assert arm.close()
    assert bus.drives[3].status == 0x40


def test_its_power_stays_off_though_the_frame_that_took_it_is_lost(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    diverge(bus, 5)
    rpdo, lost = bus.drives[5].rpdo, []

    def lose_two(data: bytes) -> None:
        if data[:2] == b"\0\0" and len(lost) < 2:
            lost.append(data)
        else:
            rpdo(data)

    bus.drives[5].rpdo = lose_two
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    wait_for(lambda: len(lost) == 2 and bus.drives[5].status == 0x40)


def test_the_others_are_stopped_though_the_main_handle_takes_no_frame_any_more() -> None:
    """STOP has a handle of its own: the frame that takes one drive's power must not stand before it."""

    class Full(FakeArmBus):
        """Takes no frame any more from the one on that takes a drive's power."""

        full = False

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            self.full = self.full or (msg.arbitration_id == 0x205 and msg.data[:2] == b"\0\0")
            if self.full:
                raise can.CanOperationError("no buffer space")
            super().send(msg, timeout)

        def stop_handle(self) -> can.BusABC:
            return Apart(self)

    class Apart(can.BusABC):
        """The handle of STOP."""

        def __init__(self, bus: FakeArmBus) -> None:
            self._bus = bus
            super().__init__(channel="fake")

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            FakeArmBus.send(self._bus, msg, timeout)

    bus = Full()
    bus.drives[7].counts = 100
    arm = make(bus)
    arm.connect()
    arm.take_control()
    arm.set_modes(TWO_DRIVEN)
    diverge(bus, 5)
    with pytest.raises(BusError, match="no longer takes frames: no buffer space"):
        capture_for_ever(arm)
    assert bus.full
    assert {drive.status for drive in bus.drives.values()} == {0x07}
    arm.close()


def test_after_a_reset_a_drive_that_was_mended_goes_on(driven: CanopenArm, bus: FakeArmBus) -> None:
    diverge(bus, 5)
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    bus.drives[5].noise = lambda _sync: 0
    driven.reset_stop()
    found = driven.snapshot()
    assert (found.stopped, found.stopped_for) == (False, "")
    assert {drive.status for drive in bus.drives.values()} == {0x40}
    driven.take_control()
    driven.set_modes(TWO_DRIVEN)
    assert driven.move({5: 0.1}, speed_rad_per_s=0.5).reached


def test_why_it_was_stopped_is_known_to_the_next_connection(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    diverge(bus, 5)
    with pytest.raises(DriveDiverged) as told:
        capture_for_ever(driven)
    driven.stop()  # pressed as well, as anybody would
    driven.close()
    bus.drives[5].noise = lambda _sync: 0
    driven.connect()
    found = driven.snapshot()
    assert (found.stopped, found.stopped_for) == (True, str(told.value))
    with pytest.raises(DriveDiverged):
        driven.take_control()
    driven.reset_stop()
    driven.close()
    driven.connect()
    assert (driven.snapshot().stopped, driven.snapshot().stopped_for) == (False, "")
    driven.stop()
    assert driven.snapshot().stopped_for == ""


def test_one_that_was_not_mended_is_stopped_again(driven: CanopenArm, bus: FakeArmBus) -> None:
    diverge(bus, 5)
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    driven.reset_stop()
    driven.take_control()
    driven.set_modes(TWO_DRIVEN)
    diverge(bus, 5)
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    assert bus.drives[5].status == 0x40


def test_a_stop_that_was_pressed_is_said_to_be_that(driven: CanopenArm) -> None:
    driven.stop()
    assert driven.snapshot().stopped_for == ""
    with pytest.raises(Stopped):
        driven.capture(1)


def test_closing_leaves_the_others_held_and_that_drive_without_power(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    diverge(bus, 5)
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    assert driven.close()
    assert bus.token == 0
    assert {j for j, drive in bus.drives.items() if drive.status == 0x40} == {5}
    assert {drive.status for j, drive in bus.drives.items() if j != 5} == {0x07}


def test_a_drive_that_creeps_on_after_a_stop_loses_its_power_and_the_operator_is_told(
    bus: FakeArmBus,
) -> None:
    arm = in_real_time(bus)
    arm.stop()
    creep_when_stopped(bus, 5)
    wait_for(lambda: bus.drives[5].status == 0x40)
    wait_for(lambda: arm.snapshot().stopped_for != "")
    told = arm.snapshot().stopped_for
    assert told.startswith("joint 5 has moved by +1")
    assert "after it was stopped" in told
    with pytest.raises(DriveDiverged, match="that drive has been switched off"):
        arm.capture(1)
    assert {d.status for j, d in bus.drives.items() if j != 5} == {0x07}
    arm.reset_stop()
    assert (arm.snapshot().stopped, arm.snapshot().stopped_for) == (False, "")
    arm.close()


def test_of_two_that_creep_on_both_lose_their_power(bus: FakeArmBus) -> None:
    arm = in_real_time(bus)
    arm.stop()
    creep_when_stopped(bus, 2, 5)
    wait_for(lambda: [bus.drives[j].status for j in (2, 5)] == [0x40, 0x40])
    arm.close()


def test_it_is_watched_though_its_drive_stopped_by_itself_and_nobody_pressed_stop(
    bus: FakeArmBus,
) -> None:
    arm = in_real_time(bus)
    for drive in bus.drives.values():
        drive.status = 0x07
    creep_when_stopped(bus, 5)
    wait_for(lambda: bus.drives[5].status == 0x40)
    assert arm.snapshot().stopped
    arm.close()


def test_a_free_joint_may_be_moved_after_a_stop(bus: FakeArmBus) -> None:
    arm = in_real_time(bus)
    arm.stop()
    creep_when_stopped(bus, 3)
    since = bus.syncs
    wait_for(lambda: bus.syncs > since + 150)
    assert arm.snapshot().stopped_for == ""
    assert bus.drives[3].status == 0x07
    arm.close()

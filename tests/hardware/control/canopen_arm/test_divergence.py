"""A drive that goes where it was not told to, on a fake bus: the arm is stopped by itself, and says why."""

import can
import pytest

from hardware.arm import JointMode
from hardware.errors import BusError, DriveDiverged
from hardware.timing import Pace
from tests.hardware.fake_arm import JOINTS, FakeArmBus, FakeDrive
from tests.hardware.on_fake_bus import TWO_DRIVEN, capture_for_ever, drive, wait_for

FAR, WINDOW = 1600, 1111
"""Counts: how far it goes, and the degree that a drive without 6065h is allowed."""
WITHOUT_5 = {j: 0x40 if j == 5 else 0x07 for j in range(1, JOINTS + 1)}
"""States of the drives when joint 5's has lost its power and the others hold."""


def diverge(bus: FakeArmBus, joint: int) -> None:
    """Let a joint creep away from here, 20 counts a SYNC, whatever it is told while it has power."""
    bus.says_it_follows = True
    begun = bus.syncs
    bus.drives[joint].noise = lambda sync: min(20 * max(sync - begun, 0), FAR)


def creep_when_stopped(bus: FakeArmBus, *joints: int) -> None:
    """Let joints creep on from here though their drives are in quick stop, until they lose their power."""
    begun = bus.syncs
    for joint in joints:
        axis = bus.drives[joint]

        def creep(sync: int, axis: FakeDrive = axis) -> int:
            return 20 * max(sync - begun, 0) if axis.status == 0x07 else 0

        axis.noise = creep


def test_diverged_drive_is_disabled_and_arm_stopped(driven, bus):
    diverge(bus, 5)
    since = len(bus.sent)
    with pytest.raises(DriveDiverged, match=r"joint 5 is \+1\d\d\d counts from its target") as told:
        capture_for_ever(driven)
    assert WINDOW < told.value.counts <= FAR
    assert {j: drive.status for j, drive in bus.drives.items()} == WITHOUT_5
    # It is never asked to hold while it has power: holding is what it does wrong.
    commands = bus.words(5, since)
    assert commands[commands.index(0x0000) - 1] == 0x000F
    assert set(bus.words(2, since)) == {0x000F, 0x0002}
    found = driven.snapshot()
    assert found.stopped
    assert found.stopped_for == str(told.value)


def test_commands_after_divergence_raise_drive_diverged(driven, bus):
    diverge(bus, 2)
    with pytest.raises(DriveDiverged):
        driven.move({5: 1.2}, speed_rad_per_s=0.2)
    begun = len(bus.sent)
    for refused in (
        lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1),
        lambda: driven.capture(1),
        lambda: driven.set_modes(TWO_DRIVEN),
        driven.take_control,
        driven.hold,
    ):
        with pytest.raises(DriveDiverged, match="the arm has been stopped"):
            refused()
    assert {word for j in bus.drives for word in bus.words(j, begun)} <= {0x0000, 0x0002}


def test_divergence_is_detected_while_idle(connected, bus):
    arm = connected(pace=Pace.REAL_TIME)
    arm.take_control()
    arm.set_modes([JointMode.POSITION] * JOINTS)
    assert arm.snapshot().stopped_for == ""
    diverge(bus, 3)
    wait_for(lambda: arm.snapshot().stopped)
    assert "joint 3 is +1" in arm.snapshot().stopped_for
    wait_for(lambda: bus.drives[3].status == 0x40)
    assert arm.close()
    assert bus.drives[3].status == 0x40


def test_lost_disable_command_is_repeated(driven, bus):
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


def test_full_main_handle_does_not_block_stop(connected):
    """STOP has a handle of its own: the frame that takes one drive's power must not stand before it."""

    class Full(FakeArmBus):
        """Takes no frame any more from the one on that takes a drive's power."""

        full = False

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            self.full = self.full or (msg.arbitration_id == 0x205 and msg.data[:2] == b"\0\0")
            if self.full:
                raise can.CanOperationError("no buffer space")
            super().send(msg, timeout)

    bus = Full()
    arm = drive(connected(bus))
    diverge(bus, 5)
    with pytest.raises(BusError, match="no longer takes frames: no buffer space"):
        capture_for_ever(arm)
    assert bus.full
    assert bus.statuses == {0x07}


def test_divergence_is_detected_again_after_reset(
    driven, bus
):
    diverge(bus, 5)
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    bus.drives[5].noise = lambda _sync: 0
    driven.reset_stop()
    found = driven.snapshot()
    assert (found.stopped, found.stopped_for) == (False, "")
    assert bus.statuses == {0x40}
    driven.take_control()
    driven.set_modes(TWO_DRIVEN)
    assert driven.move({5: 0.1}, speed_rad_per_s=0.5).reached
    diverge(bus, 5)
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    assert bus.drives[5].status == 0x40


def test_stop_reason_survives_reconnection_until_reset(
    driven, bus
):
    diverge(bus, 5)
    with pytest.raises(DriveDiverged) as told:
        capture_for_ever(driven)
    driven.stop()  # pressed as well, as anybody would
    assert driven.close()
    assert bus.token == 0
    assert {j: drive.status for j, drive in bus.drives.items()} == WITHOUT_5
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


@pytest.mark.parametrize("joints", [(5,), (2, 5)])
def test_drives_moving_after_stop_are_disabled(
    live, bus, joints
):
    live.stop()
    creep_when_stopped(bus, *joints)
    wait_for(lambda: {bus.drives[j].status for j in joints} == {0x40})
    wait_for(lambda: live.snapshot().stopped_for != "")
    told = live.snapshot().stopped_for
    assert told.startswith(tuple(f"joint {j} has moved by +1" for j in joints))
    assert "after it was stopped" in told
    with pytest.raises(DriveDiverged, match="that drive has been switched off"):
        live.capture(1)
    assert {d.status for j, d in bus.drives.items() if j not in joints} == {0x07}
    live.reset_stop()
    assert (live.snapshot().stopped, live.snapshot().stopped_for) == (False, "")


def test_drive_moving_after_its_own_quick_stop_is_disabled(live, bus):
    for axis in bus.drives.values():
        axis.status = 0x07
    creep_when_stopped(bus, 5)
    wait_for(lambda: bus.drives[5].status == 0x40)
    assert live.snapshot().stopped


def test_free_joint_may_move_after_stop(live, bus):
    live.stop()
    creep_when_stopped(bus, 3)
    since = bus.syncs
    wait_for(lambda: bus.syncs > since + 150)
    assert live.snapshot().stopped_for == ""
    assert bus.drives[3].status == 0x07


def test_second_diverged_drive_is_disabled_if_first_ignores_commands(live, bus):
    """Two drives that another program moves: the first takes no notice of STOP nor of its power being taken."""
    bus.drives[2].ignores = (0x0000, 0x0002)
    bus.drives[5].ignores = (0x0002,)
    diverge(bus, 2)
    diverge(bus, 5)
    wait_for(lambda: bus.drives[5].status == 0x40)
    assert live.snapshot().stopped
    assert "joint 2 is +1" in live.snapshot().stopped_for


def test_divergence_is_detected_despite_silent_node(live, bus):
    bus.silent = {7}
    diverge(bus, 5)
    wait_for(lambda: bus.drives[5].status == 0x40)
    assert live.snapshot().stopped
    assert "joint 5 is +1" in live.snapshot().stopped_for

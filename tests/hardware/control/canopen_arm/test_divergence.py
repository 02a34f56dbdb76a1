"""Drives that leave their targets, on a fake bus: they are disabled, the arm is stopped, the cause is reported."""

import can
import pytest

from hardware.errors import BusError, DriveDiverged
from tests.hardware.control.canopen_arm.conftest import TWO_DRIVEN, drive, wait_for
from tests.hardware.fake_arm import COUNTS_PER_REV, JOINTS, FakeArmBus, FakeDrive, capture_for_ever

FAR, WINDOW = 1600, 1111
"""Counts: final deviation of a diverging joint; one degree, the limit for a drive without 6065h."""
WITHOUT_5 = {j: 0x40 if j == 5 else 0x07 for j in range(1, JOINTS + 1)}
"""Drive states with joint 5 disabled and the others in quick stop."""


def diverge(bus: FakeArmBus, joint: int) -> None:
    """Let a joint drift from now on, 20 counts per SYNC, whatever its target."""
    begun = bus.syncs
    bus.drives[joint].noise = lambda sync: min(20 * max(sync - begun, 0), FAR)


def drift_in_quick_stop(bus: FakeArmBus, *joints: int) -> None:
    """Let joints drift while their drives are in quick stop, until they are disabled."""
    begun = bus.syncs
    for joint in joints:
        axis = bus.drives[joint]

        def drift(sync: int, axis: FakeDrive = axis) -> int:
            return 20 * max(sync - begun, 0) if axis.status == 0x07 else 0

        axis.noise = drift


def test_diverged_drive_is_disabled_and_arm_stopped(driven, bus):
    diverge(bus, 5)
    since = len(bus.sent)
    with pytest.raises(
        DriveDiverged, match=r"joint 5 is \+1\d\d\d counts from its target"
    ) as diverged:
        capture_for_ever(driven)
    counts = diverged.value.counts
    assert WINDOW < counts <= FAR
    assert f"({360 * counts / COUNTS_PER_REV:+.1f} deg)" in str(diverged.value)
    assert {j: drive.status for j, drive in bus.drives.items()} == WITHOUT_5
    # Joint 5 is disabled directly: it gets no quick stop, which would have it hold.
    words = bus.controlwords(5, since)
    assert words[words.index(0x0000) - 1] == 0x000F
    assert set(bus.controlwords(2, since)) == {0x000F, 0x0002}
    snapshot = driven.snapshot()
    assert snapshot.stopped
    assert snapshot.stopped_for == str(diverged.value)


def test_commands_after_divergence_raise_drive_diverged(driven, bus):
    diverge(bus, 2)
    with pytest.raises(DriveDiverged):
        driven.move({5: 1.2}, speed_rad_per_s=0.2)
    since = len(bus.sent)
    for command in (
        lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1),
        lambda: driven.capture(1),
        lambda: driven.set_modes(TWO_DRIVEN),
        driven.take_control,
        driven.hold,
    ):
        with pytest.raises(DriveDiverged, match="the arm has been stopped"):
            command()
    assert {word for j in bus.drives for word in bus.controlwords(j, since)} <= {0x0000, 0x0002}


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


def test_full_main_handle_does_not_block_stop(driven, bus):
    """STOP has a handle of its own, which the frame that disables one drive must not delay."""
    send, refused = bus.send, list[can.Message]()

    def refuse_from_disabling_on(msg: can.Message, timeout: float | None = None) -> None:
        if refused or (msg.arbitration_id == 0x205 and msg.data[:2] == b"\0\0"):
            refused.append(msg)
            raise can.CanOperationError("no buffer space")
        send(msg, timeout)

    bus.send = refuse_from_disabling_on
    diverge(bus, 5)
    with pytest.raises(BusError, match="no longer takes frames: no buffer space"):
        capture_for_ever(driven)
    assert refused
    assert bus.statuses == {0x07}


def test_divergence_is_detected_again_after_reset(driven, bus):
    diverge(bus, 5)
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    bus.drives[5].noise = lambda _sync: 0
    driven.reset_stop()
    snapshot = driven.snapshot()
    assert (snapshot.stopped, snapshot.stopped_for) == (False, "")
    assert bus.statuses == {0x40}
    drive(driven)
    assert driven.move({5: 0.1}, speed_rad_per_s=0.5).reached
    diverge(bus, 5)
    with pytest.raises(DriveDiverged):
        capture_for_ever(driven)
    assert bus.drives[5].status == 0x40


def test_stop_reason_survives_reconnection_until_reset(driven, bus):
    diverge(bus, 5)
    with pytest.raises(DriveDiverged) as diverged:
        capture_for_ever(driven)
    driven.stop()
    assert driven.close()
    assert bus.token == 0
    assert {j: drive.status for j, drive in bus.drives.items()} == WITHOUT_5
    bus.drives[5].noise = lambda _sync: 0
    driven.connect()
    snapshot = driven.snapshot()
    assert (snapshot.stopped, snapshot.stopped_for) == (True, str(diverged.value))
    with pytest.raises(DriveDiverged):
        driven.take_control()
    driven.reset_stop()
    driven.close()
    driven.connect()
    assert (driven.snapshot().stopped, driven.snapshot().stopped_for) == (False, "")
    driven.stop()
    assert driven.snapshot().stopped_for == ""


@pytest.mark.parametrize(("joints", "own_stop"), [((5,), False), ((2, 5), False), ((5,), True)])
def test_drives_moving_after_stop_are_disabled(live, bus, joints, own_stop):
    if own_stop:
        for axis in bus.drives.values():
            axis.status = 0x07
    else:
        live.stop()
    drift_in_quick_stop(bus, *joints)
    wait_for(lambda: {bus.drives[j].status for j in joints} == {0x40})
    wait_for(lambda: live.snapshot().stopped_for != "")
    reason = live.snapshot().stopped_for
    assert reason.startswith(tuple(f"joint {j} has moved by +1" for j in joints))
    assert "after it was stopped" in reason
    with pytest.raises(DriveDiverged, match="that drive was commanded to switch off"):
        live.capture(1)
    assert {d.status for j, d in bus.drives.items() if j not in joints} == {0x07}
    live.reset_stop()
    assert (live.snapshot().stopped, live.snapshot().stopped_for) == (False, "")


def test_free_joint_may_move_after_stop(live, bus):
    live.stop()
    drift_in_quick_stop(bus, 3)
    since = bus.syncs
    wait_for(lambda: bus.syncs > since + 150)
    assert live.snapshot().stopped_for == ""
    assert bus.drives[3].status == 0x07


@pytest.mark.parametrize(
    ("other_fault", "reported"), [("none", 5), ("silent", 5), ("ignores commands", 2)]
)
def test_divergence_is_detected_while_idle(live, bus, other_fault, reported):
    assert live.snapshot().stopped_for == ""
    if other_fault == "silent":
        bus.without_tpdo = {7}
    elif other_fault == "ignores commands":  # of two drives that another program moves
        bus.drives[2].ignores = (0x0000, 0x0002)
        bus.drives[5].ignores = (0x0002,)
        diverge(bus, 2)
    diverge(bus, 5)
    wait_for(lambda: bus.drives[5].status == 0x40)
    assert live.snapshot().stopped
    assert f"joint {reported} is +1" in live.snapshot().stopped_for

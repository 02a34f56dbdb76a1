import itertools
import math
import os
import signal
import struct
import threading
from collections.abc import Callable
from types import FrameType

import numpy as np
import pytest

from hardware.arm import ArmSnapshot
from hardware.errors import CommandRefused, DriveDiverged, DriveFault, OtherMaster, Stopped
from tests.hardware.control.canopen_arm.conftest import PER_RAD, drive
from tests.hardware.fake_arm import JOINTS, FakeArmBus


def test_move_reaches_targets_in_small_steps(driven, bus):
    result = driven.move({2: 0.2, 5: -0.1}, speed_rad_per_s=0.5)
    assert result.reached
    assert result.reason == ""
    assert bus.drives[2].counts == round(0.2 * PER_RAD)
    assert bus.drives[5].counts == round(-0.1 * PER_RAD)
    assert result.positions_rad[1] == pytest.approx(0.2, abs=1 / PER_RAD)
    targets = [target for _, target, _ in bus.drives[2].received]
    assert max(abs(b - a) for a, b in itertools.pairwise(targets)) <= 0.5 * 0.01 * PER_RAD + 1
    assert not driven.snapshot().moving


def test_joint_that_stalls_at_the_end_of_a_move_has_not_reached_its_target(driven, bus):
    """It stands 2 deg before the end, which the targets reach within the time that a servo may lag."""
    axis, end_counts = bus.drives[2], round((0.2 - math.radians(2)) * PER_RAD)
    axis.noise = lambda _sync: min(end_counts - axis.counts, 0)
    with pytest.raises(DriveDiverged) as diverged:
        driven.move({2: 0.2}, speed_rad_per_s=0.5)
    assert (diverged.value.joint, diverged.value.counts) == (2, round(-math.radians(2) * PER_RAD))


def test_move_waits_for_a_joint_that_lags_until_the_last_sync_allowed(driven, bus, monkeypatch):
    monkeypatch.setattr("hardware.control.motion_steps.ARRIVAL_SYNCS", 3)
    axis, lags = bus.drives[2], [-1500] * 5

    def lag(_sync: int) -> int:
        return lags.pop() if lags and axis.target == round(0.2 * PER_RAD) else 0

    axis.noise = lag
    result = driven.move({2: 0.2}, speed_rad_per_s=0.5)
    assert result.reached
    assert result.positions_rad[1] == pytest.approx(0.2, abs=1 / PER_RAD)


def test_move_of_joint_that_does_not_arrive_states_its_distance(arm, bus, approve):
    bus.not_following = set(bus.drives)  # so that its distance from the target is not monitored
    arm.take_control()
    bus.drives[2].noise = lambda _sync: -2222
    bus.objects[2, 0x6064, 0] = struct.pack("<l", round(0.2 * PER_RAD) - 2222)
    result = arm.move({2: 0.2}, speed_rad_per_s=0.5)
    assert not result.reached
    approve(result.reason)


def test_repeated_session_takes_equal_sync_count(connected):
    buses = FakeArmBus(), FakeArmBus()
    for fake in buses:
        arm = drive(connected(fake))
        arm.move({2: 0.2, 5: -0.1}, speed_rad_per_s=0.5)
        arm.settle(window=5, spread_rad=[1e-3] * JOINTS, timeout_syncs=50)
        arm.capture(10)
        arm.close()
    assert buses[0].syncs == buses[1].syncs


@pytest.mark.parametrize(
    ("targets", "speed"),
    [({2: 3.0}, 0.5), ({2: math.nan}, 0.5), ({2: 0.1}, 5.0), ({2: 0.1}, 0.0), ({3: 0.1}, 0.5)],
)
def test_invalid_move_is_refused_before_any_command(driven, bus, targets, speed, approve):
    before = len(bus.commands)
    with pytest.raises(CommandRefused) as refused:
        driven.move(targets, speed_rad_per_s=speed)
    approve(str(refused.value))
    assert len(bus.commands) == before


def brake_at_0_2_rad(snapshot: ArmSnapshot) -> str | None:
    return "far enough" if snapshot.joints[1].position_rad > 0.2 else None


def test_watch_ends_move_with_reason_and_deceleration(driven, bus):
    snapshots: list[ArmSnapshot] = []

    def watch(snapshot: ArmSnapshot) -> str | None:
        snapshots.append(snapshot)
        return brake_at_0_2_rad(snapshot)

    result = driven.move({2: 1.0}, speed_rad_per_s=0.5, watch=watch)
    assert (result.reached, result.reason) == (False, "far enough")
    assert 0.2 < result.positions_rad[1] < 0.5
    assert snapshots[-1].moving
    assert snapshots[-1].joints[1].speed_rad_per_s == pytest.approx(0.5, rel=0.05)
    targets = np.array([target for _, target, _ in bus.drives[2].received]) / PER_RAD
    last_steps = np.diff(targets)[-4:] / 0.01
    assert np.all(np.abs(last_steps) < 0.2), "it stopped without slowing down"
    assert bus.drives[2].counts == bus.drives[2].target


def test_watch_exception_is_raised_after_braking(driven, bus):
    def watch(snapshot: ArmSnapshot) -> str | None:
        if brake_at_0_2_rad(snapshot):
            raise RuntimeError("broken watch")
        return None

    with pytest.raises(RuntimeError, match="broken watch"):
        driven.move({2: 1.0}, speed_rad_per_s=0.5, watch=watch)
    assert driven.move({2: 0.0}, speed_rad_per_s=0.5).reached


def test_ctrl_c_brings_move_to_rest(driven, bus):
    handled = threading.Event()

    def press_ctrl_c(_sync: int) -> None:
        if bus.drives[2].target > 0.3 * PER_RAD and not handled.is_set():
            os.kill(os.getpid(), signal.SIGINT)
            handled.wait(10)  # the simulated move would otherwise end before the signal is handled

    def handle(number: int, frame: FrameType | None) -> None:
        handled.set()
        signal.default_int_handler(number, frame)

    bus.on_sync = press_ctrl_c
    before = signal.signal(signal.SIGINT, handle)
    try:
        with pytest.raises(KeyboardInterrupt):
            driven.move({2: 1.5}, speed_rad_per_s=0.5)
    finally:
        signal.signal(signal.SIGINT, before)
    final_target = bus.drives[2].target
    assert 0.3 * PER_RAD < final_target < 1.5 * PER_RAD - 1
    assert not driven.snapshot().moving
    driven.capture(20)
    assert bus.drives[2].target == final_target


def while_braking(bus: FakeArmBus, act: Callable[[], None]) -> None:
    """Let something happen 10 SYNCs after joint 2 passed 0.2 rad, where the watch begins to brake."""

    def on_sync(_sync: int) -> None:
        if bus.drives[2].counts > 0.2 * PER_RAD:
            bus.on_sync = lambda _: None
            bus.at(10, act)

    bus.on_sync = on_sync


@pytest.mark.parametrize("watch", [None, brake_at_0_2_rad])
@pytest.mark.parametrize("joint", [2, 5])
def test_tripped_drive_ends_move_and_others_hold(driven, bus, joint, watch):
    while_braking(bus, lambda: bus.trip(joint, 0x8311))
    with pytest.raises(DriveFault, match=f"^joint {joint} tripped: excess torque") as fault:
        driven.move({2: 1.0}, speed_rad_per_s=0.5, watch=watch)
    assert (fault.value.joint, fault.value.code) == (joint, 0x8311)
    assert {drive.mode for j, drive in bus.drives.items() if j != joint} == {8}
    assert [f.code for f in driven.snapshot().faults] == [0x8311]
    with pytest.raises(DriveFault):
        driven.capture(3)


def test_emergency_of_an_enabled_drive_is_not_called_a_trip(driven, bus, approve):
    bus.inject(0x85, struct.pack("<HB5x", 0x4210, 0x08))
    with pytest.raises(DriveFault) as fault:
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert bus.statuses == {0x27}
    approve(str(fault.value))


def test_other_master_takes_precedence_over_resulting_trip(driven, bus):
    """A drive that another program resets makes the others overload each other; the rest hold."""
    bus.at(40, lambda: bus.inject(0x000, b"\x81\x03"))
    bus.at(48, lambda: bus.trip(5, 0x8311))
    with pytest.raises(OtherMaster, match="'reset node' to node 3"):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert [f.code for f in driven.snapshot().faults] == [0x8311]
    assert {drive.mode for joint, drive in bus.drives.items() if joint != 5} == {8}


def test_external_stop_while_braking_stops_at_once(driven, bus):
    while_braking(bus, lambda: bus.emergency(16, 0x5441))
    with pytest.raises(Stopped, match="external stop"):
        driven.move({2: 1.0}, speed_rad_per_s=0.5, watch=brake_at_0_2_rad)
    targets = [target for _, target, _ in bus.drives[2].received]
    assert targets[-1] - targets[-2] > 0.1 * 0.01 * PER_RAD, "still moving when stopped"

"""What the operator's arm does on every transport, with the virtual controller at the other end."""

import hashlib
import math
import os
import signal
import struct
import threading
from collections.abc import Callable

import can
import numpy as np
import pytest

from hardware.arm import ArmSnapshot, DriveState
from hardware.buses.python_can import BusSettings, open_bus
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import ControlDenied, Stopped, UploadRefused
from hardware.timing import Pace
from hardware.virtual.controller import VirtualController
from tests.contracts.arm.bench import TWO_DRIVEN, controller_on, operator_on


def run_a_little(settings: BusSettings) -> tuple[int, list[float], list[float]]:
    """A short session from scratch: SYNCs taken, and what was read."""
    with controller_on(settings):
        arm = operator_on(settings)
        arm.connect()
        arm.take_control()
        arm.set_modes(TWO_DRIVEN)
        start = arm.snapshot().positions_rad
        arm.move({2: start[1] + 0.1, 5: start[4] - 0.1}, speed_rad_per_s=0.5)
        arm.settle(window=10, spread_rad=[0.01] * 7, timeout_syncs=300)
        reading = arm.capture(20)
        arm.hold()
        syncs = arm.snapshot().sync_count
        arm.close()
    return syncs, reading.mean_counts.tolist(), reading.sd_rad.tolist()


@pytest.mark.sample(1)
def test_two_driven_joints_move_the_closed_chain(driven: CanopenArm) -> None:
    start = driven.snapshot().positions_rad
    result = driven.move({2: start[1] + 0.1, 5: start[4] - 0.1}, speed_rad_per_s=0.5)
    assert result.reached
    assert driven.settle(window=20, spread_rad=[0.01] * 7, timeout_syncs=500)
    reading = driven.capture(50)
    moved = reading.mean_rad - start
    assert moved[1] == pytest.approx(0.1, abs=2e-3)
    assert moved[4] == pytest.approx(-0.1, abs=2e-3)
    assert np.abs(moved[[0, 2, 3]]).min() > 1e-3, "a free joint did not follow"
    lsb = math.radians(120) / 4096
    assert np.all(reading.sd_rad[5:] == pytest.approx(2 * lsb, rel=0.5))  # datasheet: 2 LSB
    assert np.all(reading.sd_rad[:5] < 1e-4)


@pytest.mark.sample(1)
def test_a_seeded_run_is_the_same_every_time(settings: BusSettings) -> None:
    first = run_a_little(settings)
    busy = threading.Event()
    thread = threading.Thread(target=lambda: all(not busy.is_set() for _ in iter(int, 1)))
    thread.start()  # a second run on a busy machine
    try:
        second = run_a_little(settings)
    finally:
        busy.set()
        thread.join()
    assert first == second


def test_stop_in_a_move_stops_everything(driven: CanopenArm) -> None:
    start = driven.snapshot().positions_rad

    def watch(snapshot: ArmSnapshot) -> str | None:
        if snapshot.positions_rad[1] > start[1] + 0.05:
            driven.stop()
        return None

    with pytest.raises(Stopped):
        driven.move({2: start[1] + 0.3}, speed_rad_per_s=0.3, watch=watch)
    wait_for(lambda: driven.snapshot().joints[1].drive is DriveState.QUICK_STOP_ACTIVE)
    assert driven.snapshot().positions_rad[1] < start[1] + 0.1
    with pytest.raises(Stopped):
        driven.move({2: start[1]}, speed_rad_per_s=0.3)
    driven.reset_stop()
    assert {j.drive for j in driven.snapshot().joints} == {DriveState.SWITCH_ON_DISABLED}
    driven.take_control()
    driven.set_modes(TWO_DRIVEN)
    assert driven.move({2: start[1]}, speed_rad_per_s=0.3).reached


def wait_for(condition: Callable[[], bool]) -> None:
    """Spin until a condition holds; pytest's own timeout ends what never does."""
    while not condition():
        pass


def test_ctrl_c_in_a_move_leaves_the_arm_held(driven: CanopenArm) -> None:
    start = driven.snapshot().positions_rad

    def watch(snapshot: ArmSnapshot) -> str | None:
        if snapshot.positions_rad[1] > start[1] + 0.05:
            os.kill(os.getpid(), signal.SIGINT)
        return None

    with pytest.raises(KeyboardInterrupt):
        driven.move({2: start[1] + 0.5}, speed_rad_per_s=0.3, watch=watch)
    snapshot = driven.snapshot()
    assert not snapshot.moving
    assert start[1] + 0.05 < snapshot.positions_rad[1] < start[1] + 0.45
    assert {joint.drive for joint in snapshot.joints} == {DriveState.OPERATION_ENABLED}
    held = driven.capture(50)
    assert held.mean_rad[1] == pytest.approx(snapshot.positions_rad[1], abs=1e-3)


@pytest.mark.sample(1)
def test_parameters_are_uploaded_and_read_back(driven: CanopenArm) -> None:
    document = b"11 -22 33 -44 55 -6 7".ljust(4000)
    receipt = driven.upload_parameters(document)
    assert receipt.home_offset_counts == (11, -22, 33, -44, 55, -6, 7)
    assert receipt.sha256 == hashlib.sha256(document).hexdigest()
    assert driven.active_parameters() == document
    with pytest.raises(UploadRefused, match="invalid literal"):
        driven.upload_parameters(b"eleven")
    assert driven.active_parameters() == document


def test_a_controller_without_parameters_has_none(arm: CanopenArm) -> None:
    assert arm.active_parameters() == b""


def test_two_operators_exclude_each_other(driven: CanopenArm, settings: BusSettings) -> None:
    second = operator_on(settings)
    with pytest.raises(ControlDenied):
        second.connect()
    assert driven.snapshot().token == 127
    driven.capture(1)


def test_closing_leaves_the_arm_held_and_free_to_take(
    driven: CanopenArm, settings: BusSettings
) -> None:
    before = driven.capture(10).mean_rad
    driven.close()
    driven.close()
    again = operator_on(settings)
    again.connect()
    try:
        assert again.snapshot().token == 0
        again.take_control()
        again.set_modes(TWO_DRIVEN)
        assert again.capture(10).mean_rad == pytest.approx(before, abs=5e-3)
    finally:
        again.close()


def test_real_time_keeps_the_period(controller: VirtualController, settings: BusSettings) -> None:
    arm = operator_on(settings, Pace.REAL_TIME)
    observer = open_bus(settings)
    try:
        arm.connect()
        times: list[float] = []
        while len(times) < 60:
            message = observer.recv(5.0)
            assert message is not None
            if message.arbitration_id == 0x080:
                times.append(message.timestamp)
        periods = np.diff(times)
        # On a busy machine not all of them, nor most.
        assert np.any(np.abs(periods - 0.01) < 0.002)
        assert np.mean(periods) >= 0.0099  # late ones are not made up for in a burst
    finally:
        arm.close()
        observer.shutdown()


def test_an_observer_sees_standard_frames(driven: CanopenArm, settings: BusSettings) -> None:
    """Decoded from the bytes on the bus, by the tables of CiA 301 and 402."""
    observer = open_bus(settings)
    try:
        driven.capture(1)
        answers: dict[int, can.Message] = {}
        while len(answers) < 7:
            message = observer.recv(5.0)
            assert message is not None
            if 0x181 <= message.arbitration_id <= 0x187:
                answers[message.arbitration_id] = message
    finally:
        observer.shutdown()
    snapshot = driven.snapshot()
    for joint, state in enumerate(snapshot.joints, 1):
        status, counts, _torque = struct.unpack("<Hih", answers[0x180 + joint].data)
        assert status & 0x6F == 0x27
        assert counts == state.position_counts

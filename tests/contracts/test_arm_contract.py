"""What the operator's arm does on every transport, with the virtual controller at the other end."""

from __future__ import annotations

import hashlib
import math
import os
import signal
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
import numpy as np
import pytest

from hardware.arm import ArmSnapshot, DriveState, JointMode
from hardware.buses import BusSettings, open_bus
from hardware.canopen_arm import CanopenArm
from hardware.description import (
    ArmDescription,
    EncoderDescription,
    JointDescription,
    RvdtDescription,
)
from hardware.errors import (
    BusError,
    ControlDenied,
    DriveFault,
    ModeNotReached,
    SensorFault,
    Stopped,
    TwoDevices,
    UploadRefused,
)
from hardware.timing import Pace
from hardware.virtual.axis import arm_axes
from hardware.virtual.controller import VirtualController
from hardware.virtual.parameters import ValidatedParameters
from hardware.virtual.scenarios import scenario
from hardware.virtual.supervisor_node import ArmLabel
from operator_app.config.arm_file import load_arm
from oracles.profiles import sarcos
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder, Rvdt
from tests.contracts.transports import TRANSPORTS

FREE, POSITION = JointMode.FREE, JointMode.POSITION
TWO_DRIVEN = [FREE, POSITION, FREE, FREE, POSITION, FREE, FREE]
SERIAL = "SDA-0007"
PATIENCE_S = 10.0
SCENARIO = scenario("datasheet", 3)
MODEL = SCENARIO.arm(load_arm("sarcos_dextrous"))
Connect = Callable[..., CanopenArm]


def describe(model: ArmModel) -> ArmDescription:
    def sensor(of: object) -> EncoderDescription | RvdtDescription:
        match of:
            case Encoder():
                return EncoderDescription(counts_per_rev=of.counts_per_rev)
            case Rvdt():
                return RvdtDescription(bits=of.bits, full_scale_rad=of.full_scale_rad)
        raise TypeError(of)

    return ArmDescription(
        model=model.name,
        joints=tuple(
            JointDescription(
                name=joint.name,
                lower_rad=joint.lower_rad,
                upper_rad=joint.upper_rad,
                max_speed_rad_per_s=joint.max_speed_rad_per_s,
                max_torque_nm=joint.max_torque_nm,
                sensor=sensor(joint.sensor),
            )
            for joint in model.joints
        ),
    )


def validate(document: bytes) -> ValidatedParameters:
    """A schema of this test's own: seven whole numbers, the home offsets in counts."""
    counts = tuple(int(word) for word in document.split())
    return ValidatedParameters(
        arm_serial=SERIAL,
        home_offset_counts=counts,
        theta_off_rad=tuple(
            count / axis.scale.counts_per_rad
            for count, axis in zip(counts, arm_axes(MODEL), strict=False)
        ),
    )


@contextmanager
def controller_on(settings: BusSettings) -> Iterator[VirtualController]:
    bus = open_bus(settings)
    try:
        with VirtualController(
            bus,
            SCENARIO.build(MODEL),
            axes=arm_axes(MODEL),
            arm=ArmLabel(model=MODEL.name, serial_number=SERIAL),
            validate=validate,
            # Both ends share a processor, and neither is in real time: either may wait for it.
            heartbeat_timeout_s=PATIENCE_S,
        ) as controller:
            yield controller
        assert controller.failure is None
    finally:
        bus.shutdown()


@pytest.fixture(params=TRANSPORTS)
def settings(request: pytest.FixtureRequest) -> BusSettings:
    return BusSettings(interface=request.param, channel=TRANSPORTS[request.param]())


@pytest.fixture(autouse=True)
def a_shorter_listen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hardware.connection.LISTEN_S", 0.15)


@pytest.fixture
def controller(settings: BusSettings) -> Iterator[VirtualController]:
    with controller_on(settings) as running:
        yield running


@pytest.fixture
def arm(controller: VirtualController, settings: BusSettings) -> Iterator[CanopenArm]:
    made = CanopenArm(describe(MODEL), settings, sarcos(), pace=Pace.FAST_FORWARD)
    made.connect()
    yield made
    made.close()


@pytest.fixture
def driven(arm: CanopenArm) -> CanopenArm:
    arm.take_control()
    arm.set_modes(TWO_DRIVEN)
    return arm


def run_a_little(settings: BusSettings) -> tuple[int, list[float], list[float]]:
    """A short session from scratch: SYNCs taken, and what was read."""
    with controller_on(settings):
        arm = CanopenArm(describe(MODEL), settings, sarcos(), pace=Pace.FAST_FORWARD)
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


def test_a_third_driven_joint_trips_the_torque_limit(arm: CanopenArm) -> None:
    arm.take_control()
    arm.set_modes([FREE, POSITION, POSITION, FREE, POSITION, FREE, FREE])
    start = arm.snapshot().positions_rad
    with pytest.raises(DriveFault) as fault:
        arm.move({3: start[2] + 0.3}, speed_rad_per_s=0.3)
    assert fault.value.code == 0x8311
    snapshot = arm.snapshot()
    assert 0x8311 in {found.code for found in snapshot.faults}
    assert DriveState.OPERATION_ENABLED not in {joint.drive for joint in snapshot.joints}
    arm.reset_stop()
    arm.take_control()
    assert {joint.drive for joint in arm.snapshot().joints} == {DriveState.OPERATION_ENABLED}


def test_a_drive_that_refuses_a_mode_is_named(
    arm: CanopenArm, controller: VirtualController
) -> None:
    arm.take_control()
    controller.faults.refuse_modes(6)
    with pytest.raises(ModeNotReached) as late:
        arm.set_modes(TWO_DRIVEN)
    assert late.value.joint == 6


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
    second = CanopenArm(describe(MODEL), settings, sarcos(), pace=Pace.FAST_FORWARD)
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
    again = CanopenArm(describe(MODEL), settings, sarcos(), pace=Pace.FAST_FORWARD)
    again.connect()
    try:
        assert again.snapshot().token == 0
        again.take_control()
        again.set_modes(TWO_DRIVEN)
        assert again.capture(10).mean_rad == pytest.approx(before, abs=5e-3)
    finally:
        again.close()


def test_real_time_keeps_the_period(controller: VirtualController, settings: BusSettings) -> None:
    arm = CanopenArm(describe(MODEL), settings, sarcos(), pace=Pace.REAL_TIME)
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


@pytest.mark.parametrize("counts", [5, 500, -1111])
def test_counts_lost_at_rest_are_noticed_before_the_pose_counts(
    driven: CanopenArm, controller: VirtualController, counts: int
) -> None:
    driven.settle(window=10, spread_rad=[0.01] * 7, timeout_syncs=300)
    driven.capture(20)
    controller.faults.lose_counts(3, counts)
    with pytest.raises(SensorFault, match="joint 3 jumped") as told:
        driven.capture(40)
    assert told.value.joint == 3
    assert f"by {counts:+d} counts" in str(told.value)


@pytest.mark.parametrize("counts", [500, -1111])
def test_counts_lost_in_a_move_are_noticed(
    driven: CanopenArm, controller: VirtualController, counts: int
) -> None:
    here = driven.snapshot().positions_rad
    lost = threading.Event()

    def watch(snapshot: ArmSnapshot) -> None:
        if abs(snapshot.positions_rad[1] - here[1]) > 0.1 and not lost.is_set():
            controller.faults.lose_counts(4, counts)
            lost.set()

    with pytest.raises(SensorFault, match="joint 4 jumped") as told:
        driven.move({2: here[1] + 0.3}, speed_rad_per_s=0.5, watch=watch)
    assert lost.is_set()
    assert told.value.joint == 4


def test_a_drive_that_restarts_with_its_counter_at_zero_is_named(
    driven: CanopenArm, controller: VirtualController
) -> None:
    controller.faults.restart_node(5)
    with pytest.raises(BusError, match="5") as told:
        driven.capture(2000)
    assert "restart" in str(told.value) or "left operation" in str(told.value)


def test_a_joint_that_answers_twice_is_two_devices(
    driven: CanopenArm, controller: VirtualController
) -> None:
    controller.faults.answer_twice(7)
    with pytest.raises(TwoDevices, match="node 7"):
        driven.capture(2000)


def test_two_controllers_on_one_bus_are_named(
    controller: VirtualController, settings: BusSettings
) -> None:
    with controller_on(settings):
        arm = CanopenArm(describe(MODEL), settings, sarcos(), pace=Pace.FAST_FORWARD)
        with pytest.raises(TwoDevices, match="two devices answer as node"):
            arm.connect()


@pytest.mark.parametrize("frame", [2, 3, 9])
def test_ctrl_c_in_an_upload_is_an_interrupt_and_the_next_one_works(
    driven: CanopenArm, monkeypatch: pytest.MonkeyPatch, frame: int
) -> None:
    driven.hold()
    document = b"1 2 3 4 5 6 7" + b" " * 200
    wire, sent = driven._link._wire, []
    whole = wire.send

    def interrupted(identifier: int, data: bytes) -> None:
        if identifier == 0x610:
            sent.append(data)
            if len(sent) == frame:
                raise KeyboardInterrupt
        whole(identifier, data)

    sender = driven._link.access._network
    monkeypatch.setattr(sender, "_send", interrupted)
    with pytest.raises(KeyboardInterrupt):
        driven.upload_parameters(document)
    assert driven.active_parameters() == b""
    assert driven.upload_parameters(document).length == len(document)
    assert driven.active_parameters() == document

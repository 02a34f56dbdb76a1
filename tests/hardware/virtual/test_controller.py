"""The controller on the bus: raw frames against the numbers of the standards."""

import struct
from collections.abc import Sequence

import can
import pytest

from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand, PlantReading
from hardware.virtual.controller import VirtualController
from tests.hardware.control.canopen_arm.conftest import wait_for
from tests.hardware.virtual.conftest import NODES, wait_for_heartbeats
from tests.oracles.virtual_rig import ARM, TrivialPlant, axes, parse, rig

STATE = 0x006F


@pytest.fixture
def arm(arm):
    wait_for_heartbeats(arm)
    return arm


def test_nodes_boot_once_and_wait_for_nmt_start():
    with rig() as arm:
        for node in NODES:
            assert arm.peer.wait_for(lambda number, _: number > 0x700) == (0x700 + node, b"\0")
        arm.peer.send(0x080)
        arm.peer.read(1, 0x1000)
        assert not [number for number, _ in arm.peer.log if 0x180 <= number < 0x200]


@pytest.mark.parametrize(("command", "state"), [(1, 5), (2, 4), (128, 127)])
def test_heartbeats_contain_the_nmt_state(arm, command, state):
    arm.peer.nmt(command)
    arm.clock.time_s += 0.11
    wait_for_heartbeats(arm, state)


def test_heartbeats_are_sent_every_100_ms(arm):
    arm.peer.log.clear()
    for _ in range(3):
        arm.clock.time_s += 0.1
        wait_for_heartbeats(arm)
    arm.clock.time_s += 0.09
    arm.run_in_loop()
    arm.peer.quiet()
    assert [len(arm.peer.seen(0x700 + node)) for node in NODES] == [3] * 8


def test_stopped_node_answers_neither_sdo_nor_sync(arm):
    arm.peer.start()
    arm.peer.nmt(2, 3)
    arm.peer.send(0x603, struct.pack("<BHB4x", 0x40, 0x1000, 0))
    arm.peer.send(0x080)
    arm.peer.read(4, 0x1000)  # answered after everything before it
    assert arm.peer.seen(0x583) == []
    assert arm.peer.seen(0x183) == []
    assert len(arm.peer.seen(0x184)) == 1
    arm.peer.nmt(128, 3)
    assert arm.peer.unsigned(3, 0x1000) == 0x00020192


def test_reset_boots_the_node_and_only_reset_communication_holds(arm):
    arm.operational()
    arm.peer.log.clear()
    arm.peer.nmt(130, 2)
    arm.peer.nmt(129, 3)
    arm.run_in_loop()
    booted = [number for number, data in arm.peer.log if number > 0x700 and data == b"\0"]
    assert booted == [0x702, 0x703]
    arm.peer.nmt(1)
    states = arm.peer.sync()
    assert states[1][0] & STATE == 0x07
    assert states[2][0] & 0x4F == 0x40
    modes = arm.run_in_loop(lambda: [mode for mode, _ in arm.plant.commands[1:3]])
    assert modes == [JointMode.POSITION, None]


@pytest.mark.parametrize("command", [2, 128])
def test_leaving_operational_stops_and_holds_drives(arm, command):
    arm.operational([10] * 7)
    arm.peer.nmt(command)
    arm.peer.send(0x080)
    arm.peer.nmt(1)
    states = arm.peer.sync()
    assert all(word & STATE == 0x07 for word, _, _ in states)
    assert {mode for mode, _ in arm.plant.commands} == {JointMode.POSITION}


def test_sync_steps_the_plant_once_and_sends_each_tpdo1_once(arm):
    arm.peer.start()
    before = arm.run_in_loop(lambda: arm.plant.steps)
    for _ in range(20):
        arm.peer.sync()  # asserts the order of the joints
    assert arm.run_in_loop(lambda: arm.plant.steps) == before + 20
    assert arm.run_in_loop(lambda: arm.controller.sync_count) == 20


def test_tpdo1_contains_statusword_counts_and_torque(arm):
    arm.peer.start()

    def set_plant() -> None:
        arm.plant.angles_rad[0], arm.plant.torque_nm[0] = -1.0, -12.34
        arm.plant.torque_nm[1] = 1e9

    arm.run_in_loop(set_plant)
    states = arm.peer.sync()
    assert states[0] == (0x0050, -5730, -123)  # 36000 counts a turn; 100 N m rated
    assert states[1][2] == 32767


def test_rpdo1_takes_effect_without_sync_once_operational(arm):
    arm.peer.take_control()
    arm.peer.command(4, 0x06, 0, 8)
    assert arm.peer.unsigned(4, 0x6041) & STATE == 0x40
    arm.peer.start()
    for word, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27), (0x02, 0x07)):
        arm.peer.command(4, word, 0, 8)
        assert arm.peer.unsigned(4, 0x6041) & STATE == state


def test_malformed_extended_remote_and_foreign_frames_are_ignored(arm):
    arm.operational()
    for data in (b"", b"\x02", b"\x02\x00\x00", b"\x63\x00"):
        arm.peer.send(0x000, data)
    for data in (b"", bytes(6), bytes(8)):
        arm.peer.send(0x201, data)
    arm.peer.send(0x7E5, bytes(8))
    arm.peer.send(0x123, b"\xff" * 8)
    for message in (
        can.Message(arbitration_id=0x201, data=bytes(7), is_extended_id=True),
        can.Message(arbitration_id=0x80, is_extended_id=True),
        can.Message(arbitration_id=0x80, is_remote_frame=True, is_extended_id=False),
    ):
        arm.peer.bus.send(message)
    count = arm.run_in_loop(lambda: arm.controller.sync_count)
    assert [word & STATE for word, _, _ in arm.peer.sync()] == [0x27] * 7
    assert arm.run_in_loop(lambda: arm.controller.sync_count) == count + 1


def test_second_close_is_safe_and_bus_stays_open(arm):
    arm.controller.close()
    arm.controller.close()
    arm.peer.send(0x080)
    assert arm.controller.failure is None


def test_closed_bus_is_reported_as_the_failure():
    bus = can.Bus("goes-away", interface="virtual")
    plant = TrivialPlant([a.scale.counts_per_rad for a in axes()])
    controller = VirtualController(bus, plant, axes=axes(), arm=ARM, validate=parse)
    controller.start()
    bus.shutdown()
    wait_for(lambda: controller.failure is not None)
    controller.close()
    assert isinstance(controller.failure, can.CanError)


class FailingPlant(TrivialPlant):
    def step(self, commands: Sequence[JointCommand]) -> PlantReading:
        if self.steps == 5:
            raise ArithmeticError("the loop does not close")
        return super().step(commands)


def test_failing_plant_ends_heartbeats_and_close_raises():
    plant = FailingPlant([a.scale.counts_per_rad for a in axes()])
    with pytest.raises(ArithmeticError, match="does not close"), rig(plant=plant) as arm:  # noqa: PT012
        arm.peer.start()
        for _ in range(5):
            arm.peer.send(0x080)
        wait_for(lambda: arm.controller.failure is not None)
        arm.peer.quiet()
        arm.peer.log.clear()
        arm.clock.time_s += 1.0
        arm.peer.send(0x601, b"\x40\x00\x10\x00\x00\x00\x00\x00")
        assert arm.peer.receive(0.1) is None
        assert isinstance(arm.controller.failure, ArithmeticError)

"""A bus on which the receiving thread runs the virtual arm in its own process."""

import queue
import threading
from collections.abc import Sequence

import can
import pytest

from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.objects import COB_SYNC, COB_TPDO1
from hardware.virtual import controller as controller_module
from hardware.virtual.axis import JointCommand, PlantReading
from hardware.virtual.controller import VirtualController
from hardware.virtual.embedded_bus import EmbeddedBus, attended_opener
from tests.hardware.control.canopen_arm.conftest import wait_for
from tests.oracles.virtual_rig import ARM, TrivialPlant, axes, parse

JOINTS = 7
SETTINGS = BusSettings(channel="attended-openers")


class ThreadLoggingPlant(TrivialPlant):
    """Logs the name of the thread of each step; fails on request."""

    def __init__(self) -> None:
        super().__init__([axis.scale.counts_per_rad for axis in axes()])
        self.threads: list[str] = []
        self.fails = False

    def step(self, commands: Sequence[JointCommand]) -> PlantReading:
        self.threads.append(threading.current_thread().name)
        if self.fails:
            raise ArithmeticError("no pose closes the loop")
        return super().step(commands)


@pytest.fixture
def plant():
    return ThreadLoggingPlant()


@pytest.fixture
def idle_thread(monkeypatch):
    """The arm's own thread receives every two seconds only, however busy the machine."""
    monkeypatch.setattr(controller_module, "_POLL_S", 2.0)


@pytest.fixture
def controller(plant):
    with open_bus(SETTINGS) as bus:
        controller = VirtualController(
            bus, plant, axes=axes(), arm=ARM, validate=parse, attended=True
        )
        controller.start()
        yield controller
        controller.close()


@pytest.fixture
def bus(controller):
    with attended_opener(controller)(SETTINGS) as bus:
        bus.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))
        yield bus


def send_sync(bus: can.BusABC) -> None:
    bus.send(can.Message(arbitration_id=COB_SYNC, is_extended_id=False))


def is_answer(message: can.Message) -> bool:
    return COB_TPDO1 < message.arbitration_id < COB_TPDO1 + 0x80


def count_answers(bus: can.BusABC, wait_s: float) -> int:
    """Count TPDO1 until no frame arrives for `wait_s`."""
    count = 0
    while (message := bus.recv(wait_s)) is not None:
        count += is_answer(message)
    return count


def test_waiting_thread_steps_the_plant(idle_thread, bus, plant):
    plant.threads.clear()
    for _ in range(50):
        send_sync(bus)
        answers = 0
        while answers < JOINTS:
            answers += is_answer(bus.recv(30.0))
    assert count_answers(bus, 0.05) == 0
    assert len(plant.threads) == 50
    assert plant.threads.count(threading.current_thread().name) >= 45


def test_frame_of_another_thread_wakes_the_waiting_thread(idle_thread, bus, plant):
    """As in an SDO upload: one thread sends the request, the other receives."""
    received: queue.Queue[int] = queue.Queue()
    ended = threading.Event()

    def receive() -> None:
        while not ended.is_set():
            if bus.recv(0.5) is not None:
                received.put(1)

    reader = threading.Thread(target=receive, name="reader")
    reader.start()
    for _ in range(50):
        send_sync(bus)
        for _ in range(JOINTS):
            received.get(timeout=30.0)
    ended.set()
    reader.join()
    assert plant.threads.count("reader") >= 25, "the arm's own thread steps the plant"


def test_frame_is_answered_while_no_thread_waits(bus, controller):
    """STOP is sent from another thread, whatever the operator's loop does."""
    before = controller.sync_count
    send_sync(bus)
    wait_for(lambda: controller.sync_count > before)
    assert controller.sync_count == before + 1


def test_hanging_arm_does_not_block_its_operator(bus, controller):
    controller.running.clear()
    send_sync(bus)
    assert count_answers(bus, 0.05) == 0
    controller.running.set()
    count = 0
    while count < JOINTS:  # or pytest's own timeout ends the test
        count += count_answers(bus, 0.05)
    assert count == JOINTS


def test_failing_plant_silences_the_arm_and_not_its_operator(bus, controller, plant):
    plant.fails = True
    send_sync(bus)
    assert count_answers(bus, 0.05) == 0
    assert isinstance(controller.failure, ArithmeticError)
    plant.fails = False
    send_sync(bus)
    assert count_answers(bus, 0.05) == 0


def test_embedded_bus_exchanges_frames_with_virtual_bus():
    channel = "embedded-and-virtual"
    with (
        EmbeddedBus(channel) as embedded,
        EmbeddedBus(channel) as other,
        can.Bus(interface="virtual", channel=channel) as virtual,
    ):
        virtual.send(can.Message(arbitration_id=0x181, data=b"x", is_extended_id=False))
        received = embedded.recv(0.0)
        assert (received.arbitration_id, received.is_rx) == (0x181, True)
        assert embedded.recv(0.0) is None
        embedded.send(can.Message(arbitration_id=0x7F, is_extended_id=False))
        assert [m.arbitration_id for m in iter(lambda: other.recv(0.0), None)] == [0x181, 0x7F]
        assert virtual.recv(60.0).arbitration_id == 0x7F
        assert embedded.recv(0.01) is None

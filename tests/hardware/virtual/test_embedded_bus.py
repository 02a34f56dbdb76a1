"""An operator that takes in the frames of the arm in its own process."""

import queue
import threading
import time
from collections.abc import Sequence

import can
import pytest

from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.objects import COB_SYNC, COB_TPDO1
from hardware.virtual.axis import JointCommand, PlantReading
from hardware.virtual.controller import VirtualController
from hardware.virtual.embedded_bus import EmbeddedBus, attended_openers
from tests.oracles.virtual_rig import ARM, TrivialPlant, axes

JOINTS = 7


class CountingPlant(TrivialPlant):
    """Says in which threads it was stepped; breaks when told to."""

    def __init__(self) -> None:
        super().__init__([axis.scale.counts_per_rad for axis in axes()])
        self.threads: list[str] = []
        self.broken = False

    def step(self, commands: Sequence[JointCommand]) -> PlantReading:
        self.threads.append(threading.current_thread().name)
        if self.broken:
            raise ArithmeticError("no pose closes the loop")
        return super().step(commands)


@pytest.fixture
def plant():
    return CountingPlant()


@pytest.fixture
def settings(request):
    return BusSettings(channel=f"attended_openers-{request.node.name}")


@pytest.fixture
def controller(plant, settings):
    bus = open_bus(settings)
    made = VirtualController(bus, plant, axes=axes(), arm=ARM, attended=True)
    made.start()
    yield made
    made.close()
    bus.shutdown()


@pytest.fixture
def bus(controller, settings):
    made = attended_openers(controller).main(settings)
    start_all(made)
    yield made
    made.shutdown()


def start_all(bus: can.BusABC) -> None:
    bus.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))


def sync(bus: can.BusABC) -> None:
    bus.send(can.Message(arbitration_id=COB_SYNC, is_extended_id=False))


def answers(bus: can.BusABC, wait_s: float) -> int:
    """How many joints answer before nothing comes for `wait_s`."""
    count = 0
    while (message := bus.recv(wait_s)) is not None:
        count += COB_TPDO1 < message.arbitration_id < COB_TPDO1 + 0x80
    return count


def test_who_waits_for_the_answer_steps_the_plant(bus, plant):
    plant.threads.clear()
    mine = 0
    for _ in range(50):
        sync(bus)
        assert answers(bus, 0.001) == JOINTS
    mine = plant.threads.count(threading.current_thread().name)
    assert len(plant.threads) == 50
    assert mine >= 45, "the arm's own thread looks now and then as well"


def test_a_reader_that_sleeps_is_woken_by_what_another_thread_sends(bus, plant):
    """As an object is read: one thread asks, the other one waits for whatever comes."""
    heard: queue.Queue[int] = queue.Queue()
    ended = threading.Event()

    def listen() -> None:
        while not ended.is_set():
            if bus.recv(0.5) is not None:
                heard.put(1)

    reader = threading.Thread(target=listen, name="reader")
    reader.start()
    for _ in range(50):
        sync(bus)
        for _ in range(JOINTS):
            heard.get(timeout=30.0)
    ended.set()
    reader.join()
    assert plant.threads.count("reader") >= 25, (
        "else the arm's own thread looks first, when its time comes"
    )


def test_what_others_send_is_answered_while_nobody_waits(bus, controller):
    """STOP goes out from another thread, whatever the operator's loop does."""
    before = controller.sync_count
    sync(bus)
    deadline = time.monotonic() + 30.0
    while controller.sync_count == before and time.monotonic() < deadline:
        time.sleep(0.005)
    assert controller.sync_count == before + 1


def test_an_arm_that_hangs_does_not_hang_its_operator(bus, controller):
    controller.hang()
    sync(bus)
    assert answers(bus, 0.05) == 0
    controller.resume_loop()
    deadline = time.monotonic() + 30.0
    while not (found := answers(bus, 0.05)) and time.monotonic() < deadline:
        pass
    assert found == JOINTS


def test_an_arm_that_breaks_is_silent_and_its_operator_lives(bus, controller, plant):
    plant.broken = True
    sync(bus)
    assert answers(bus, 0.05) == 0
    assert isinstance(controller.failure, ArithmeticError)
    plant.broken = False
    sync(bus)
    assert answers(bus, 0.05) == 0


def test_frames_pass_between_embedded_and_stock_buses_and_filters_hold():
    channel = "embedded-and-stock"
    with (
        EmbeddedBus(channel) as embedded,
        EmbeddedBus(channel) as other,
        can.Bus(interface="virtual", channel=channel) as stock,
    ):
        embedded.set_filters([{"can_id": 0x181, "can_mask": 0x7FF, "extended": False}])
        for identifier in (0x80, 0x182, 0x181):
            stock.send(can.Message(arbitration_id=identifier, data=b"x", is_extended_id=False))
        # A frame that the filter keeps out does not hide the one behind it, even without waiting.
        received = embedded.recv(0.0)
        assert received is not None
        assert (received.arbitration_id, received.is_rx) == (0x181, True)
        assert embedded.recv(0.0) is None
        embedded.send(can.Message(arbitration_id=0x7F, is_extended_id=False))
        assert [m.arbitration_id for m in iter(lambda: other.recv(0.0), None)] == [
            0x80, 0x182, 0x181, 0x7F,
        ]  # fmt: skip
        assert (answer := stock.recv(1.0)) is not None
        assert answer.arbitration_id == 0x7F
        assert embedded.recv(0.01) is None

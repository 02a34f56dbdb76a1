"""Foreign frames are kept out where an adapter can, and never pass for an empty queue where none can."""

import uuid
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack

import can
import pytest
from can.typechecking import CanFilters

from hardware.buses.acceptance_filters import controller_filters, set_hardware_filters
from hardware.buses.loopback import LoopbackBus
from hardware.buses.shared_bus import SharedBus

FOREIGN, SYNC, NMT = 0x123, 0x080, 0x000


class Plain(can.BusABC):
    """An adapter that takes in every frame: its other end is itself."""

    def __init__(self) -> None:
        self.queue: deque[can.Message] = deque()
        super().__init__(channel="plain")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.queue.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return (self.queue.popleft() if self.queue else None), self._filters_itself()

    def _filters_itself(self) -> bool:
        return False


class RoomForOne(Plain):
    """Shaped like python-can's Kvaser and Vector: one filter in the adapter, or all of them in python-can."""

    def __init__(self) -> None:
        self._is_filtered = False
        super().__init__()

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self._is_filtered = filters is not None and len(filters) == 1

    def _filters_itself(self) -> bool:
        return self._is_filtered


def pair(interface: str, stack: ExitStack) -> tuple[can.BusABC, can.BusABC]:
    if interface in ("plain", "room for one"):
        bus = Plain() if interface == "plain" else RoomForOne()
        stack.callback(bus.shutdown)
        return bus, bus
    channel = f"keep-{uuid.uuid4().hex[:8]}"
    one, other = (
        LoopbackBus(channel) if interface == "loopback" else can.Bus(channel, interface="virtual")
        for _ in range(2)
    )
    stack.callback(one.shutdown)
    stack.callback(other.shutdown)
    return one, other


@pytest.fixture(params=["loopback", "plain", "room for one"])
def buses(request: pytest.FixtureRequest) -> Iterator[tuple[can.BusABC, can.BusABC]]:
    with ExitStack() as stack:
        yield pair(request.param, stack)


def test_an_answer_behind_foreign_frames_is_found_without_waiting(
    buses: tuple[can.BusABC, can.BusABC],
) -> None:
    arm, talker = buses
    set_hardware_filters(arm, controller_filters(7))
    for identifier in (SYNC, FOREIGN, FOREIGN + 1, NMT):
        talker.send(can.Message(arbitration_id=identifier, is_extended_id=False))
    wire = SharedBus(arm)
    first = wire.receive(1.0)
    found = [first]
    while found[-1] is not None:
        found.append(wire.receive(0.0))
    assert NMT in {message.arbitration_id for message in found if message is not None}


def test_a_kernel_keeps_them_out() -> None:
    with ExitStack() as stack:
        arm, talker = pair("loopback", stack)
        set_hardware_filters(arm, controller_filters(7))
        for identifier in (FOREIGN, SYNC):
            talker.send(can.Message(arbitration_id=identifier, is_extended_id=False))
        message = arm.recv(1.0)
        assert message is not None
        assert message.arbitration_id == SYNC

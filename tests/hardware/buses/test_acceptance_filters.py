"""Foreign frames are kept out where an adapter can, and never pass for an empty queue where none can."""

import uuid
from collections import deque

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


@pytest.fixture(params=["loopback", "plain", "room for one"])
def buses(request):
    """The arm's bus, and who else sends there."""
    if request.param == "loopback":
        channel = f"keep-{uuid.uuid4().hex[:8]}"
        with LoopbackBus(channel) as arm, LoopbackBus(channel) as talker:
            yield arm, talker
    else:
        with Plain() if request.param == "plain" else RoomForOne() as bus:
            yield bus, bus


def test_an_answer_behind_foreign_frames_is_found_without_waiting(buses):
    arm, talker = buses
    set_hardware_filters(arm, controller_filters(7))
    for identifier in (SYNC, FOREIGN, FOREIGN + 1, NMT):
        talker.send(can.Message(arbitration_id=identifier, is_extended_id=False))
    wire = SharedBus(arm)
    found = {message.arbitration_id for message in (wire.receive(1.0),) if message}
    while (message := wire.receive(0.0)) is not None:
        found.add(message.arbitration_id)
    assert {SYNC, NMT} <= found
    if isinstance(arm, LoopbackBus):
        assert FOREIGN not in found, "a kernel keeps them out"

"""Foreign frames are filtered out where an adapter can do so, and never hide a later frame."""

import uuid
from collections import deque

import can
import pytest
from can.typechecking import CanFilters

from hardware.buses.acceptance_filters import controller_filters, set_hardware_filters
from hardware.buses.loopback import LoopbackBus
from hardware.buses.shared_bus import SharedBus

FOREIGN, SYNC, NMT = 0x123, 0x080, 0x000


class Adapter(can.BusABC):
    """Receives every frame that it sends itself.

    With `filters_one`, like Kvaser and Vector in python-can, it applies a single filter, and python-can several.
    """

    def __init__(self, *, filters_one: bool) -> None:
        self.queue: deque[can.Message] = deque()
        self.filters_one = filters_one
        super().__init__(channel="plain")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.queue.append(msg)

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self._is_filtered = self.filters_one and filters is not None and len(filters) == 1

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return (self.queue.popleft() if self.queue else None), self._is_filtered


@pytest.fixture(params=["loopback", "adapter without filters", "adapter with one filter"])
def buses(request):
    """The receiving bus and the sending bus."""
    if request.param == "loopback":
        channel = f"filters-{uuid.uuid4().hex[:8]}"
        with LoopbackBus(channel) as receiver, LoopbackBus(channel) as sender:
            yield receiver, sender
    else:
        with Adapter(filters_one=request.param.endswith("one filter")) as bus:
            yield bus, bus


def test_frame_behind_foreign_frames_is_received_without_waiting(buses):
    receiver, sender = buses
    set_hardware_filters(receiver, controller_filters(7))
    sender.send(can.Message(arbitration_id=SYNC + 1, is_extended_id=True))
    for identifier in (SYNC, FOREIGN, FOREIGN + 1, NMT):
        sender.send(can.Message(arbitration_id=identifier, is_extended_id=False))
    shared = SharedBus(receiver)
    identifiers = {message.arbitration_id for message in (shared.receive(1.0),) if message}
    while (message := shared.receive(0.0)) is not None:
        identifiers.add(message.arbitration_id)
    assert {SYNC, NMT} <= identifiers
    assert SYNC + 1 not in identifiers
    if isinstance(receiver, LoopbackBus):
        assert FOREIGN not in identifiers, "the kernel filters them"

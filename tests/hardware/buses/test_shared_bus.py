"""A transmit queue that is full: frames wait as long as no SYNC is late by it, and then the error says what to set."""

from __future__ import annotations

import errno
import time

import can
import pytest

from hardware.buses.shared_bus import SharedBus, queue_is_full
from hardware.errors import BusError


def no_buffer_space() -> can.CanOperationError:
    """As python-can's socketcan raises it."""
    return can.CanOperationError("Failed to transmit: No buffer space", errno.ENOBUFS)


class FullQueue(can.BusABC):
    """Takes a frame only after it was offered `refusals` times."""

    def __init__(self, refusals: int, error: Exception) -> None:
        self.refusals, self.error = refusals, error
        self.sent: list[int] = []
        super().__init__(channel="can0")
        self.channel = "can0"

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.refusals > 0:
            self.refusals -= 1
            raise self.error
        self.sent.append(msg.arbitration_id)


@pytest.mark.parametrize(
    "error",
    [
        no_buffer_space(),
        OSError(errno.ENOBUFS, "No buffer space available"),
        can.CanOperationError("Transmit buffer full"),
    ],
)
def test_a_frame_that_the_queue_has_no_room_for_is_offered_again_and_counted(
    error: Exception,
) -> None:
    bus = FullQueue(3, error)
    # One's own process may stand still for longer than a control period.
    wire = SharedBus(bus, send_timeout_s=5.0)
    wire.send(0x201, b"1")
    wire.send(0x080, b"")
    assert bus.sent == [0x201, 0x080]
    assert wire.queue_full == 3


def test_a_queue_that_stays_full_ends_it_when_a_sync_would_be_late() -> None:
    wire = SharedBus(FullQueue(1_000_000, no_buffer_space()), send_timeout_s=0.02)
    begun_s = time.monotonic()
    with pytest.raises(BusError, match="ip link set can0 txqueuelen") as full:
        wire.send(0x080, b"")
    assert time.monotonic() - begun_s >= 0.02
    assert queue_is_full(full.value)
    assert wire.queue_full > 0


def test_a_bus_that_is_gone_is_not_waited_for() -> None:
    bus = FullQueue(1, OSError(errno.ENETDOWN, "Network is down"))
    wire = SharedBus(bus, send_timeout_s=5.0)
    with pytest.raises(BusError, match="Check adapter"):
        wire.send(0x080, b"")
    assert bus.refusals == 0
    assert wire.queue_full == 0

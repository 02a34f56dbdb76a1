"""A transmit queue that is full: frames wait as long as no SYNC is late by it, and then the error says what to set."""

import errno
import random
import time
from collections.abc import Iterable
from pathlib import Path

import can
import pytest

from hardware.buses.shared_bus import REORDER_S, Recording, SharedBus, queue_is_full
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
def test_a_frame_that_the_queue_has_no_room_for_is_offered_again_and_counted(error):
    bus = FullQueue(3, error)
    # One's own process may stand still for longer than a control period.
    wire = SharedBus(bus, send_timeout_s=5.0)
    wire.send(0x201, b"1")
    wire.send(0x080, b"")
    assert bus.sent == [0x201, 0x080]
    assert wire.queue_full == 3


def test_a_queue_that_stays_full_ends_it_when_a_sync_would_be_late():
    wire = SharedBus(FullQueue(1_000_000, no_buffer_space()), send_timeout_s=0.02)
    begun_s = time.monotonic()
    with pytest.raises(BusError, match="ip link set can0 txqueuelen") as full:
        wire.send(0x080, b"")
    assert time.monotonic() - begun_s >= 0.02
    assert queue_is_full(full.value)
    assert wire.queue_full > 0


def test_a_bus_that_is_gone_is_not_waited_for():
    bus = FullQueue(1, OSError(errno.ENETDOWN, "Network is down"))
    wire = SharedBus(bus, send_timeout_s=5.0)
    with pytest.raises(BusError, match="Check adapter"):
        wire.send(0x080, b"")
    assert bus.refusals == 0
    assert wire.queue_full == 0


def frame(number: int, stamp: float) -> can.Message:
    return can.Message(
        arbitration_id=number & 0x7FF,
        data=number.to_bytes(4, "little"),
        is_extended_id=False,
        timestamp=stamp,
    )


def record(path: Path, stamps: Iterable[float]) -> list[int]:
    """Numbers of the frames of these times, as they were recorded."""
    recording = Recording(path)
    for number, stamp in enumerate(stamps):
        recording.record(frame(number, stamp))
    recording.close()
    return [number for number, _ in recorded(path)]


def recorded(path: Path) -> list[tuple[int, float]]:
    with can.LogReader(path) as frames:
        return [(int.from_bytes(f.data, "little"), f.timestamp) for f in frames]


@pytest.mark.parametrize("suffix", [".blf", ".log"])
def test_frames_that_were_taken_late_are_written_in_their_place(tmp_path, suffix):
    chance = random.Random(4)  # noqa: S311 - no secret
    stamps = [1.7e9 + 0.001 * k for k in range(3000)]
    taken = sorted(
        range(len(stamps)), key=lambda k: stamps[k] + chance.uniform(0.0, 0.9 * REORDER_S)
    )
    assert taken != sorted(taken)
    recording = Recording(tmp_path / f"bus{suffix}")
    for number in taken:
        (recording.note if number % 7 == 0 else recording.record)(frame(number, stamps[number]))
    recording.close()
    recording.close()
    assert recording.failure is None
    found = recorded(tmp_path / f"bus{suffix}")
    assert [number for number, _ in found] == list(range(3000))
    assert [stamp for _, stamp in found] == pytest.approx(stamps, abs=1e-5)


def test_frames_of_one_moment_stay_in_the_order_they_came(tmp_path):
    assert record(tmp_path / "bus.log", [1.7e9] * 100) == list(range(100))


def test_a_clock_that_is_set_back_loses_and_holds_back_nothing(tmp_path):
    stamps = [5000.0, 5000.1, 1000.0, 1000.2, 1000.1, 1000.3, 9000.0, 9000.1]
    assert record(tmp_path / "bus.log", stamps) == [0, 1, 2, 4, 3, 5, 6, 7]


def test_a_link_that_leads_nowhere_is_not_recorded_through(tmp_path):
    (tmp_path / "bus.log").symlink_to(tmp_path / "elsewhere.log")
    recording = Recording(tmp_path / "bus.log")
    recording.record(can.Message(arbitration_id=0x80, is_extended_id=False, timestamp=1.0))
    recording.close()
    assert not (tmp_path / "elsewhere.log").exists()
    assert "080" in (tmp_path / "bus-2.log").read_text()

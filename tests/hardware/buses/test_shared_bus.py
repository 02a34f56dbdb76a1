import errno
import random
import time
from collections.abc import Iterable
from pathlib import Path
from unittest.mock import Mock

import can
import pytest

from hardware.buses.shared_bus import REORDER_S, Recording, SharedBus, queue_is_full
from hardware.errors import BusError


def no_buffer_space() -> can.CanOperationError:
    return can.CanOperationError("Failed to transmit: No buffer space", errno.ENOBUFS)


class FullQueueBus(can.BusABC):
    """Refuses frames `refusals` times, then accepts them."""

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
    [no_buffer_space(), OSError(errno.ENOBUFS, ""), can.CanOperationError("Transmit buffer full")],
)
def test_frame_refused_by_a_full_queue_is_sent_again_and_counted(error):
    bus = FullQueueBus(3, error)
    shared = SharedBus(bus, send_timeout_s=5.0)
    shared.send(0x201, b"1")
    shared.send(0x080, b"")
    assert (bus.sent, shared.queue_full) == ([0x201, 0x080], 3)


def test_queue_full_until_the_timeout_raises_bus_error():
    shared = SharedBus(FullQueueBus(1_000_000, no_buffer_space()), send_timeout_s=0.02)
    start_s = time.monotonic()
    with pytest.raises(BusError, match="ip link set can0 txqueuelen") as full:
        shared.send(0x080, b"")
    assert time.monotonic() - start_s >= 0.02
    assert (queue_is_full(full.value), shared.queue_full > 0) == (True, True)


def test_other_send_error_raises_bus_error_at_once():
    bus = FullQueueBus(1, OSError(errno.ENETDOWN, "Network is down"))
    shared = SharedBus(bus, send_timeout_s=5.0)
    with pytest.raises(BusError, match="Check adapter"):
        shared.send(0x080, b"")
    assert (bus.refusals, shared.queue_full) == (0, 0)


def frame(number: int, stamp: float) -> can.Message:
    return can.Message(
        arbitration_id=number & 0x7FF,
        data=number.to_bytes(4, "little"),
        is_extended_id=False,
        timestamp=stamp,
        channel="bench-4294967296",  # for .blf, python-can packs this number into two bytes
    )


def record(path: Path, stamps: Iterable[float]) -> list[int]:
    """Record frames with these timestamps; return their numbers in the order of the file."""
    recording = Recording(path)
    for number, stamp in enumerate(stamps):
        recording.record(frame(number, stamp))
    recording.close()
    return [number for number, _ in read_recording(path)]


def read_recording(path: Path) -> list[tuple[int, float]]:
    with can.LogReader(path) as frames:
        return [(int.from_bytes(f.data, "little"), f.timestamp) for f in frames]


@pytest.mark.parametrize("suffix", [".blf", ".log"])
def test_frames_received_late_are_recorded_in_order(tmp_path, suffix):
    rng = random.Random(4)  # noqa: S311 - no secret
    stamps = [1.7e9 + 0.001 * k for k in range(3000)]
    order = sorted(range(len(stamps)), key=lambda k: stamps[k] + rng.uniform(0.0, 0.9 * REORDER_S))
    assert order != sorted(order)
    recording = Recording(tmp_path / f"bus{suffix}")
    for number in order:
        (recording.note if number % 7 == 0 else recording.record)(frame(number, stamps[number]))
    recording.close()
    recording.close()
    assert recording.failure is None
    numbers, times = zip(*read_recording(tmp_path / f"bus{suffix}"), strict=True)
    assert (numbers, times) == (tuple(range(3000)), pytest.approx(stamps, abs=1e-5))


def test_clock_set_back_loses_and_delays_no_frame(tmp_path):
    stamps = [5000.0, 5000.1, 5000.1, 1000.0, 1000.2, 1000.1, 1000.3, 9000.0, 9000.1]
    assert record(tmp_path / "bus.log", stamps) == [0, 1, 2, 3, 5, 4, 6, 7, 8]
    assert record(tmp_path / "equal.asc", [1.7e9] * 100) == list(range(100))


def test_format_without_its_package_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("can.Logger", Mock(side_effect=NotImplementedError))
    with pytest.raises(BusError, match="Choose another file"):
        Recording(tmp_path / "bus.mf4")


def test_dangling_link_is_not_followed(tmp_path):
    (tmp_path / "bus.log").symlink_to(tmp_path / "elsewhere.log")
    recording = Recording(tmp_path / "bus.log")
    recording.record(frame(0x80, 1.0))
    recording.close()
    assert not (tmp_path / "elsewhere.log").exists()
    assert "080" in (tmp_path / "bus-2.log").read_text()

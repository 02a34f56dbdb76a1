"""Shares a bus handle between threads, and records a bus to a file, even while another program uses the bus."""

import errno
import heapq
import itertools
import os
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import can

from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.objects import CONTROL_PERIOD_S
from hardware.errors import BusError

REORDER_S: Final = 0.5
"""Longest delay with which a frame may arrive and still be written in order."""
_WRITE_ERRORS = (OSError, ValueError, struct.error)


class Recording:
    """Writes frames to a file in the order of their time stamps; its methods may be called from any thread.

    A received frame may have waited in a queue, so each frame is held back until `REORDER_S` after its stamp. The
    format is that of the suffix of `path` (``.blf``, ``.asc``, ``.log``, ...). An existing file is kept, and a numbered
    one (``bus-2.blf``) is written instead. Raises `BusError` if the recording cannot be started.
    """

    def __init__(self, path: Path) -> None:
        self.failure: str | None = None
        """Why recording ended early (a full disk must not stop the arm); None if it did not."""
        self._lock = threading.Lock()
        self._noted: deque[can.Message] = deque()
        self._waiting: list[tuple[float, int, can.Message]] = []
        self._arrivals = itertools.count()
        self._newest_s = 0.0
        self._numbers_channels = path.suffix.lower() == ".blf"
        try:
            self._writer: Any = can.Logger(str(_unused(path)))
        except (OSError, ValueError, NotImplementedError) as error:
            raise BusError(
                f"The bus cannot be recorded to {path}: {error}. Choose another file."
            ) from error

    def note(self, message: can.Message) -> None:
        """Queue a frame for the next `record`; never blocks."""
        self._noted.append(message)

    def record(self, message: can.Message) -> None:
        """Record a frame and the frames queued by `note`."""
        self.note(message)
        self._write(to_end=False)

    def close(self) -> None:
        """Write the remaining frames and end. May be called twice."""
        self._write(to_end=True)

    def _write(self, *, to_end: bool) -> None:
        with self._lock:
            queued = [self._noted.popleft() for _ in range(len(self._noted))]
            if self._writer is None:
                return
            try:
                for message in queued:
                    self._keep(message)
                self._write_until(float("inf") if to_end else self._newest_s - REORDER_S)
                if to_end:
                    self._writer.stop()
                    self._writer = None
            except _WRITE_ERRORS as error:
                self.failure = str(error)
                self._waiting.clear()
                writer, self._writer = self._writer, None
                with suppress(*_WRITE_ERRORS):  # reported already
                    writer.stop()

    def _keep(self, message: can.Message) -> None:
        if self._numbers_channels:
            message.channel = None  # BLF reads digits at the end of a name as a channel number
        stamp = message.timestamp
        if stamp < self._newest_s - REORDER_S:  # the clock was set back
            self._write_until(float("inf"))
            self._newest_s = stamp
        self._newest_s = max(self._newest_s, stamp)
        heapq.heappush(self._waiting, (stamp, next(self._arrivals), message))

    def _write_until(self, stamp: float) -> None:
        while self._waiting and self._waiting[0][0] <= stamp:
            self._writer(heapq.heappop(self._waiting)[2])


def _unused(path: Path) -> Path:
    candidate, k = path, 2
    while os.path.lexists(candidate):
        candidate, k = path.with_name(f"{path.stem}-{k}{path.suffix}"), k + 1
    return candidate


_MAX_SKIPPED = 200
"""Consecutive frames, other than data frames with a standard identifier, after which `receive` returns None."""
_LISTENER_POLL_S = 0.05
QUEUE_FULL_PAUSE_S = 0.0005
"""Pause before sending again: a queue of ten frames at 1 Mbit/s has room again after 0.13 ms."""


def queue_is_full(error: BaseException) -> bool:
    """Whether the kernel or python-can refused a frame because the transmit queue is full."""
    code = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if code == errno.ENOBUFS or "Transmit buffer full" in str(error):
        return True
    return error.__cause__ is not None and queue_is_full(error.__cause__)


class SharedBus:
    """Sends from any thread, receives in one thread, and records every frame to `record_to`, if given.

    `close` shuts the `bus` down. Sending is retried for `send_timeout_s` while the transmit queue is full.
    """

    def __init__(
        self,
        bus: can.BusABC,
        *,
        record_to: Path | None = None,
        send_timeout_s: float = CONTROL_PERIOD_S,
    ) -> None:
        self._bus, self._send_timeout_s = bus, send_timeout_s
        self._channel = getattr(bus, "channel", bus.channel_info)
        self._send_lock = threading.Lock()
        self._pause = threading.Event()
        self.queue_full = 0
        """Number of retries because of a full transmit queue."""
        self._recording = None if record_to is None else Recording(record_to)

    @property
    def recording_failure(self) -> str | None:
        """Why recording ended early; None if it did not."""
        return None if self._recording is None else self._recording.failure

    def send(self, identifier: int, data: bytes) -> None:
        """Send a data frame with a standard identifier; `BusError` if the bus does not take it."""
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        try:
            with self._send_lock:
                message.timestamp = time.time()  # before sending: earlier than the answer's stamp
                self._send_with_retries(message)
        except Exception as error:  # drivers raise anything
            raise BusError(
                f"The bus no longer takes frames: {error}. {self._remedy(error)}"
            ) from error
        if self._recording is not None:
            message.is_rx = False
            self._recording.record(message)

    def _send_with_retries(self, message: can.Message) -> None:
        deadline_s, self._full_before = time.monotonic() + self._send_timeout_s, self.queue_full
        while True:
            try:
                self._bus.send(message)
            except (can.CanError, OSError) as error:
                if not queue_is_full(error) or time.monotonic() >= deadline_s:
                    raise
                self.queue_full += 1
                self._pause.wait(QUEUE_FULL_PAUSE_S)
            else:
                return

    def _remedy(self, error: Exception) -> str:
        if not queue_is_full(error):
            return "Check adapter, cable and power."
        return (
            f"Its transmit queue was full for {1e3 * self._send_timeout_s:.0f} ms, after {self._full_before} "
            f"retries of earlier frames. Lengthen it: sudo ip link set {self._channel} txqueuelen 1000; and check that "
            "another node acknowledges the frames (cable, bitrate, terminators)."
        )

    def send_at_once(self, message: can.Message) -> None:
        """Send a frame without the send lock, for STOP; `BusError` if the bus does not take it."""
        try:
            self._bus.send(message, timeout=0.0)
        except Exception as error:  # drivers raise anything
            raise BusError(f"The bus no longer takes frames: {error}.") from error

    def note_sent(self, message: can.Message) -> None:
        """Record a frame that was sent through another handle and carries a time stamp; never blocks."""
        if self._recording is not None:
            message.is_rx = False
            self._recording.note(message)

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next data frame with a standard identifier; None after `timeout_s` or 200 frames of other kinds.

        Raises `BusError` if the bus cannot be read.
        """
        for _ in range(_MAX_SKIPPED):
            try:
                message = self._bus.recv(timeout_s)
            except Exception as error:  # drivers raise anything
                raise BusError(
                    f"The bus can no longer be read: {error}. Check adapter, cable and power."
                ) from error
            if message is None:
                return None
            if self._recording is not None:
                self._recording.record(message)
            if not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                return message
            timeout_s = 0.0
        return None

    def close(self) -> None:
        """End the recording and shut the bus down. May be called twice."""
        if self._recording is not None:
            self._recording.close()
        with suppress(Exception):  # an unplugged adapter cannot be closed
            self._bus.shutdown()


@contextmanager
def receiving(
    bus: SharedBus, take_in: Callable[[can.Message], None], name: str
) -> Iterator[list[str]]:
    """Context in which thread `name` passes each received data frame to `take_in`, at the end also the queued frames.

    Yields a list that receives the error text if the bus can no longer be read. Closes the bus at the end.
    """
    over, failures = threading.Event(), list[str]()

    def listen() -> None:
        try:
            while not over.is_set():
                if (message := bus.receive(_LISTENER_POLL_S)) is not None:
                    take_in(message)
            while (message := bus.receive(0.0)) is not None:
                take_in(message)
        except BusError as error:
            failures.append(str(error))

    thread = threading.Thread(target=listen, name=name, daemon=True)
    thread.start()
    try:
        yield failures
    finally:
        over.set()
        thread.join(_LISTENER_POLL_S * 100)
        bus.close()


@contextmanager
def record_bus(settings: BusSettings, path: Path) -> Iterator[Callable[[], str | None]]:
    """Context in which a separate thread records the bus through a handle of its own.

    Yields a function that returns why recording ended early, or None if it did not. Raises `BusError` if the bus cannot
    be opened a second time, or the file cannot be created.
    """
    bus = SharedBus(open_bus(settings), record_to=path)
    with receiving(bus, lambda _: None, "sarcal-recording") as failures:
        yield lambda: bus.recording_failure or next(iter(failures), None)

"""One bus handle shared by threads, and what is recorded of it. Knows frames; no node and no arm."""

from __future__ import annotations

import errno
import threading
import time
from copy import copy
from pathlib import Path
from typing import Any

import can

from hardware.buses.recording import Recording
from hardware.canopen.objects import CONTROL_PERIOD_S
from hardware.errors import BusError

_PASSED_OVER = 200
"""Frames of other kinds in a row, after which `receive` lets its caller look at the clock."""


QUEUE_FULL_PAUSE_S = 0.0005
"""A queue of ten frames at 1 Mbit/s has room again after 0.13 ms."""


def queue_is_full(error: BaseException) -> bool:
    """Whether a frame was not taken because those before it wait still: by the kernel, or by python-can's select."""
    code = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if code == errno.ENOBUFS or "Transmit buffer full" in str(error):
        return True
    return error.__cause__ is not None and queue_is_full(error.__cause__)


class Frame(can.Message):
    """A frame that nobody changes once it is sent, so that its receivers in this process may share its data.

    python-can's virtual bus makes a deep copy for each of them: a sixth of the processor that a calibration of the
    simulated arm took.
    """

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, Any] | None) -> can.Message:
        return copy(self)


class SharedBus:
    """Sends and receives frames on a bus; every frame may be recorded.

    Sending is safe from any thread. Receiving belongs to one thread.

    Parameters
    ----------
    bus
        Open bus; `close` shuts it down.
    record_to
        File to record to, see `Recording`.
    patience_s
        How long a frame is offered to a transmit queue that is full: the time between SYNCs.

    Attributes
    ----------
    queue_full
        How often the transmit queue did not take a frame that was offered again.

    Raises
    ------
    BusError
        If the recording cannot be started.
    """

    def __init__(
        self,
        bus: can.BusABC,
        *,
        record_to: Path | None = None,
        patience_s: float = CONTROL_PERIOD_S,
    ) -> None:
        self._bus, self._patience_s = bus, patience_s
        self._channel = getattr(bus, "channel", bus.channel_info)
        self._send_lock = threading.Lock()
        self._pause = threading.Event()
        self.queue_full = 0
        self._recording = None if record_to is None else Recording(record_to)

    @property
    def recording_failure(self) -> str | None:
        """Why recording ended early, None if it did not: a full disk must not stop the arm."""
        return None if self._recording is None else self._recording.failure

    def send(self, identifier: int, data: bytes) -> None:
        """Send a data frame with a standard identifier.

        Raises
        ------
        BusError
            If the bus does not take it.
        """
        message = Frame(arbitration_id=identifier, data=data, is_extended_id=False)
        try:
            with self._send_lock:
                # Before: whoever is slow to come back from sending must not seem to speak after the answer.
                message.timestamp = time.time()
                self._send_when_taken(message)
        except (can.CanError, OSError) as error:
            raise BusError(
                f"The bus does not take frames any more: {error}. {self._remedy(error)}"
            ) from error
        if self._recording is not None:
            message.is_rx = False
            self._recording.record(message)

    def _send_when_taken(self, message: can.Message) -> None:
        """Send a frame, again and again for as long as the transmit queue is full and no SYNC is late by it."""
        deadline_s = time.monotonic() + self._patience_s
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
            f"Its transmit queue was full for {1e3 * self._patience_s:.0f} ms, and {self.queue_full} times before. "
            f"Lengthen it: sudo ip link set {self._channel} txqueuelen 1000; and check that another node acknowledges "
            "the frames (cable, bitrate, terminators)."
        )

    def send_at_once(self, message: can.Message) -> None:
        """Send a frame without waiting for the lock that keeps senders apart: for STOP.

        Raises
        ------
        BusError
            If the bus does not take it.
        """
        try:
            self._bus.send(message, timeout=0.0)
        except (can.CanError, OSError) as error:
            raise BusError(f"The bus does not take frames any more: {error}.") from error

    def note_sent(self, message: can.Message) -> None:
        """Have a frame recorded that went out another way, with its own time stamp. Waits for nothing."""
        if self._recording is not None:
            message.is_rx = False
            self._recording.note(message)

    def receive(self, timeout_s: float) -> can.Message | None:
        """Next data frame with a standard identifier, or None after at most `timeout_s`.

        None as well when only frames of other kinds come, and no end of them: the caller has other duties.

        Raises
        ------
        BusError
            If the bus cannot be read any more.
        """
        for _ in range(_PASSED_OVER):
            try:
                message = self._bus.recv(timeout_s)
            except (can.CanError, OSError, ValueError) as error:
                raise BusError(
                    f"The bus cannot be read any more: {error}. Check adapter, cable and power."
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
        """End the recording and shut the bus down. Safe to call twice."""
        if self._recording is not None:
            self._recording.close()
        self._bus.shutdown()

"""One bus handle shared by threads, and what is recorded of it. Knows frames; no node and no arm."""

from __future__ import annotations

import struct
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import can

from hardware.errors import BusError

_PASSED_OVER = 200
"""Frames of other kinds in a row, after which `receive` lets its caller look at the clock."""


class Wire:
    """Sends and receives frames on a bus; every frame may be recorded.

    Sending is safe from any thread. Receiving belongs to one thread.

    Parameters
    ----------
    bus
        Open bus; `close` shuts it down.
    record_to
        File to record to, in the format its suffix names (``.blf``, ``.asc``, ``.log``, ...). What was
        recorded before is evidence: beside a file of that name another is begun, ``bus-2.blf``.

    Attributes
    ----------
    recording_failure
        Why recording ended early, None if it did not: a full disk must not stop the arm.

    Raises
    ------
    BusError
        If the recording cannot be started.
    """

    def __init__(self, bus: can.BusABC, *, record_to: Path | None = None) -> None:
        self._bus = bus
        self._send_lock = threading.Lock()
        self._record_lock = threading.Lock()
        self.recording_failure: str | None = None
        self._writer: Any = None
        self._unrecorded: deque[can.Message] = deque()
        self._numbers_channels = record_to is not None and record_to.suffix.lower() == ".blf"
        if record_to is not None:
            try:
                self._writer = can.Logger(str(_unused(record_to)))
            except (OSError, ValueError) as error:
                raise BusError(
                    f"The bus cannot be recorded to {record_to}: {error}. Choose another file."
                ) from error

    def send(self, identifier: int, data: bytes) -> None:
        """Send a data frame with a standard identifier.

        Raises
        ------
        BusError
            If the bus does not take it.
        """
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        try:
            with self._send_lock:
                # Before: whoever is slow to come back from sending must not seem to speak after the answer.
                message.timestamp = time.time()
                self._bus.send(message)
        except (can.CanError, OSError) as error:
            raise BusError(
                f"The bus does not take frames any more: {error}. Check adapter, cable and power."
            ) from error
        if self._writer is not None:
            message.is_rx = False
            self._record(message)

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
        if self._writer is not None:
            message.is_rx = False
            self._unrecorded.append(message)

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
            if self._writer is not None:
                self._record(message)
            if not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                return message
            timeout_s = 0.0
        return None

    def close(self) -> None:
        """End the recording and shut the bus down. Safe to call twice."""
        with self._record_lock:
            writer, self._writer = self._writer, None
            if writer is not None:
                try:
                    while self._unrecorded:
                        writer(self._unrecorded.popleft())
                    writer.stop()
                except (OSError, ValueError, struct.error) as error:
                    self.recording_failure = str(error)
        self._bus.shutdown()

    def _record(self, message: can.Message) -> None:
        with self._record_lock:
            if self._writer is None:
                return
            if self._numbers_channels:
                message.channel = (
                    None  # a name that ends in digits is taken for a number, of any size
                )
            try:
                while self._unrecorded:
                    self._writer(self._unrecorded.popleft())
                self._writer(message)
            except (OSError, ValueError, struct.error) as error:
                self.recording_failure = str(error)
                writer, self._writer = self._writer, None
                with suppress(OSError, ValueError, struct.error):  # said already
                    writer.stop()


def _unused(path: Path) -> Path:
    """Find a file that is not there yet: of this name, or of the first number beside it that is free."""
    candidate, k = path, 2
    while candidate.exists():
        candidate, k = path.with_name(f"{path.stem}-{k}{path.suffix}"), k + 1
    return candidate

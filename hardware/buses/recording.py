"""The file that a bus is recorded to: frames in the order of their time stamps. Knows no bus and no node."""

from __future__ import annotations

import heapq
import itertools
import os
import struct
import threading
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import can

from hardware.errors import BusError

LATEST_S: Final = 0.5
"""How late a frame may be taken from a bus and still be written in its place."""
_BROKEN = (OSError, ValueError, struct.error)


class Recording:
    """Frames in a file, in the order in which they were on the bus.

    What this program sends is stamped as it is sent; what it hears may wait in a queue meanwhile. So frames
    are kept back until none can come any more that is earlier. Safe from any thread.

    Parameters
    ----------
    path
        File to record to, in the format its suffix names (``.blf``, ``.asc``, ``.log``, ...). What was
        recorded before is evidence: beside a file of that name another is begun, ``bus-2.blf``.

    Attributes
    ----------
    failure
        Why recording ended early, None if it did not: a full disk must not stop the arm.

    Raises
    ------
    BusError
        If the recording cannot be started.
    """

    def __init__(self, path: Path) -> None:
        self.failure: str | None = None
        self._lock = threading.Lock()
        self._noted: deque[can.Message] = deque()
        self._waiting: list[tuple[float, int, can.Message]] = []
        self._arrivals = itertools.count()
        self._newest_s = 0.0
        self._numbers_channels = path.suffix.lower() == ".blf"
        try:
            self._writer: Any = can.Logger(str(_unused(path)))
        except (OSError, ValueError) as error:
            raise BusError(
                f"The bus cannot be recorded to {path}: {error}. Choose another file."
            ) from error

    def note(self, message: can.Message) -> None:
        """Have a frame recorded by whoever records next: waits for nothing."""
        self._noted.append(message)

    def record(self, message: can.Message) -> None:
        """Record a frame, and what was noted before."""
        with self._lock:
            if self._writer is None:
                return
            try:
                self._take_in()
                self._keep(message)
                self._write_until(self._newest_s - LATEST_S)
            except _BROKEN as error:
                self._end_early(error)

    def close(self) -> None:
        """Write what is kept back and end. Safe to call twice."""
        with self._lock:
            if self._writer is None:
                return
            try:
                self._take_in()
                self._write_until(float("inf"))
                self._writer.stop()
            except _BROKEN as error:
                self._end_early(error)
            self._writer = None

    def _end_early(self, error: Exception) -> None:
        self.failure = str(error)
        self._waiting.clear()
        writer, self._writer = self._writer, None
        with suppress(*_BROKEN):  # said already
            writer.stop()

    def _take_in(self) -> None:
        while self._noted:
            self._keep(self._noted.popleft())

    def _keep(self, message: can.Message) -> None:
        if self._numbers_channels:
            message.channel = None  # a name that ends in digits is taken for a number, of any size
        stamp = message.timestamp
        if (
            stamp < self._newest_s - LATEST_S
        ):  # the clock was set back: what was before it is before
            self._write_until(float("inf"))
            self._newest_s = stamp
        self._newest_s = max(self._newest_s, stamp)
        heapq.heappush(self._waiting, (stamp, next(self._arrivals), message))

    def _write_until(self, stamp: float) -> None:
        while self._waiting and self._waiting[0][0] <= stamp:
            self._writer(heapq.heappop(self._waiting)[2])


def _unused(path: Path) -> Path:
    """Find a file that is not there yet: of this name, or of the first number beside it that is free."""
    candidate, k = path, 2
    while os.path.lexists(candidate):
        candidate, k = path.with_name(f"{path.stem}-{k}{path.suffix}"), k + 1
    return candidate

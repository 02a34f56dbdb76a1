"""Recording of a bus to a file, frames in the order of their time stamps."""

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

REORDER_S: Final = 0.5
"""Delay of a frame up to which it is still written in order."""
_WRITE_ERRORS = (OSError, ValueError, struct.error)


class Recording:
    """Writes frames to a file in bus order; safe from any thread.

    Sent frames are stamped when sent, received ones may wait in a queue, so frames are held back `REORDER_S`.

    Parameters
    ----------
    path
        File to record to, in the format of its suffix (``.blf``, ``.asc``, ``.log``, ...). An existing file is
        kept, and ``bus-2.blf`` written beside it.

    Attributes
    ----------
    failure
        Why recording ended early (a full disk must not stop the arm); None if it did not.

    Raises
    ------
    BusError
        The recording cannot be started.
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
        """Queue a frame for the next `record`; waits for nothing."""
        self._noted.append(message)

    def record(self, message: can.Message) -> None:
        """Record a frame, and those queued by `note`."""
        with self._lock:
            if self._writer is None:
                return
            try:
                self._take_in()
                self._keep(message)
                self._write_until(self._newest_s - REORDER_S)
            except _WRITE_ERRORS as error:
                self._end_early(error)

    def close(self) -> None:
        """Write the remaining frames and end. May be called twice."""
        with self._lock:
            if self._writer is None:
                return
            try:
                self._take_in()
                self._write_until(float("inf"))
                self._writer.stop()
            except _WRITE_ERRORS as error:
                self._end_early(error)
            self._writer = None

    def _end_early(self, error: Exception) -> None:
        self.failure = str(error)
        self._waiting.clear()
        writer, self._writer = self._writer, None
        with suppress(*_WRITE_ERRORS):  # reported already
            writer.stop()

    def _take_in(self) -> None:
        while self._noted:
            self._keep(self._noted.popleft())

    def _keep(self, message: can.Message) -> None:
        if self._numbers_channels:
            message.channel = None  # BLF takes a name that ends in digits for a channel number
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
    """Return this path if it is free, else with the first free number added."""
    candidate, k = path, 2
    while os.path.lexists(candidate):
        candidate, k = path.with_name(f"{path.stem}-{k}{path.suffix}"), k + 1
    return candidate

"""Whole lines from the descriptor of a pipe or connection, with those before a question discarded."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time

from hardware.errors import InstrumentError

END_S = 3.0
"""Time-out for the reader to end."""
LONGEST = 64 * 1024
"""Largest length of a line, characters."""
CHUNK_BYTES = 64 * 1024
"""Bytes read at once."""
KEPT_BYTES = 1024 * 1024
"""Bytes buffered; older ones are dropped."""
IN_TRANSIT = 16 * 1024 * 1024
"""More bytes than a connection can hold: what follows them was sent after the question."""


class LineStream:
    """Lines of a descriptor, read at once by a thread so that the sender never blocks."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._news = threading.Condition()
        self._came, self._last = bytearray(), b""
        self._unended = 0
        self._skipping = False
        self._ended = False
        # Reads the descriptor: a lock on sys.stdin held at exit would abort the interpreter.
        self._reader = threading.Thread(target=self._read, name="sarcal-lines", daemon=True)
        self._reader.start()

    def forget(self) -> None:
        """Discard everything sent so far, including the rest of an incomplete line."""
        left = IN_TRANSIT
        with self._news:
            while left > 0 and (count := self._take()):
                left -= count
            self._drop()

    def line(self, wait_s: float, name: str) -> str | None:
        """Return the next whole line; None on time-out; EOFError(last line) at the end."""
        with self._news:
            self._news.wait_for(
                lambda: self._ended or self._unended >= LONGEST or b"\n" in self._came, wait_s
            )
            found, end, _ = self._came.partition(b"\n")
            if end:
                del self._came[: len(found) + 1]
                return found.decode(errors="replace").rstrip("\r")
            require_short(self._unended, name)
            if self._ended:
                raise EOFError(self._last.decode(errors="replace")[:200])
            return None

    def end(self, connection: socket.socket) -> None:
        """End the reader and close the connection."""
        self._ended = True
        with contextlib.suppress(OSError):  # the other end hung up first
            connection.shutdown(socket.SHUT_RDWR)
        self._reader.join(END_S)
        connection.close()

    def _read(self) -> None:
        while not self._ended:
            self._ready(None)
            with self._news:
                full = self._take() == CHUNK_BYTES
                self._news.notify_all()
            if full:
                time.sleep(0.001)  # a sender without pause must not starve the bus

    def _ready(self, wait_s: float | None) -> bool:
        try:
            return bool(select.select([self._descriptor], [], [], wait_s)[0])
        except (OSError, ValueError):  # closed
            return True

    def _take(self) -> int:
        """Read once; return the number of bytes."""
        if self._ended or not self._ready(0.0):
            return 0
        try:
            data = os.read(self._descriptor, CHUNK_BYTES)
        except OSError:
            data = b""
        if not data:
            self._ended = True
        count = len(data)
        at = data.rfind(b"\n")
        self._unended = self._unended + count if at < 0 else count - at - 1
        if self._skipping:
            _, end, data = data.partition(b"\n")
            self._skipping = not end
        self._came += data
        if len(self._came) > KEPT_BYTES:
            self._drop()
        return count

    def _drop(self) -> None:
        whole, end, _ = self._came.rpartition(b"\n")
        if end:
            self._last = bytes(whole.rpartition(b"\n")[2])
        self._came.clear()
        self._skipping = self._unended > 0


def require_short(length: int, name: str) -> None:
    """Raise `InstrumentError` for a line without end on the port `name`."""
    if length >= LONGEST:
        raise InstrumentError(
            f"{name} sends no lines: {length} characters without an end of line. It must send one JSON "
            "object a line"
        )

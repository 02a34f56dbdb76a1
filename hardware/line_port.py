"""Text lines from an instrument: over TCP, from standard input, or from a growing file.

Each measurement starts with a question to the instrument. Lines received before the question belong to another pose
and are discarded. Over TCP the question is sent as a line; an instrument may ignore it.
"""

import contextlib
import os
import select
import socket
import stat
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import BinaryIO

from hardware.errors import InstrumentError

END_S = 3.0
"""Time-out for the reading thread to end."""
LONGEST = 64 * 1024
"""Maximum length of a line, bytes."""
CHUNK_BYTES = 64 * 1024
"""Bytes read at once."""
KEPT_BYTES = 1024 * 1024
"""Largest number of bytes that are buffered; if more arrive unread, all are dropped."""
IN_TRANSIT = 16 * 1024 * 1024
"""Largest number of bytes that a connection buffers. `forget` reads no more than this, and so ends in any case."""


class LineStream:
    """Lines of a file descriptor; a thread reads them as they arrive, so that the sender never blocks."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._news = threading.Condition()
        self._came, self._last = bytearray(), b""
        self._unended = 0
        self._skipping = False
        self._ended = False
        # The thread reads the descriptor: if it held the lock of sys.stdin at exit, the interpreter would abort.
        self._reader = threading.Thread(target=self._read, name="sarcal-lines", daemon=True)
        self._reader.start()

    def forget(self) -> None:
        """Discard everything sent so far, including the rest of an incomplete line."""
        remaining = IN_TRANSIT
        with self._news:
            while remaining > 0 and (count := self._take()):
                remaining -= count
            self._drop()

    def line(self, wait_s: float, name: str) -> str | None:
        """Return the next line; None on time-out. At end of file, raise `EOFError` with the last discarded line."""
        with self._news:
            self._news.wait_for(
                lambda: self._ended or self._unended >= LONGEST or b"\n" in self._came, wait_s
            )
            line, end, _ = self._came.partition(b"\n")
            if end:
                del self._came[: len(line) + 1]
                return line.decode(errors="replace").rstrip("\r")
            require_short(self._unended, name)
            if self._ended:
                raise EOFError(self._last.decode(errors="replace")[:200])
            return None

    def end(self, connection: socket.socket) -> None:
        """End the reading thread and close the connection."""
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
        complete, end, _ = self._came.rpartition(b"\n")
        if end:
            self._last = bytes(complete.rpartition(b"\n")[2])
        self._came.clear()
        self._skipping = self._unended > 0


def require_short(length: int, name: str) -> None:
    """Raise `InstrumentError` if an unfinished line of `length` bytes from the port `name` reaches `LONGEST`."""
    if length >= LONGEST:
        raise InstrumentError(
            f"{name} sends no lines: {length} bytes without an end of line. It must send one JSON "
            "object per line"
        )


CONNECT_S = 3.0
"""Time-out for connecting over TCP."""
FILE_POLL_S = 0.05
"""Polling period of a file."""


class LinePort(ABC):
    """Port at which an instrument's lines arrive; `name` is the value of the option ``--tracker``.

    `sends_questions`: whether the port sends questions to the instrument. All calls must come from one thread. They
    raise `InstrumentError` on failure.
    """

    sends_questions = True

    def __init__(self, name: str) -> None:
        self.name = name

    def open(self) -> str:
        """Connect; return the header line of a file, or an empty string for other sources."""
        return ""

    @abstractmethod
    def ask(self, question: str) -> None:
        """Discard earlier lines and send the question."""

    @abstractmethod
    def line(self, wait_s: float) -> str | None:
        """Return the next whole line since `ask`; None if there is none within `wait_s`."""

    def close(self) -> None:  # noqa: B027 - most have nothing to close
        """Close the source. May be called twice."""


class CalledLines(LinePort):
    """Port to an instrument that is simulated in this process, by a function that answers questions."""

    def __init__(self, answer: Callable[[str], str], name: str) -> None:
        super().__init__(name)
        self._function = answer
        self._answer: str | None = None

    def ask(self, question: str) -> None:
        """Call the instrument's function; `line` returns its answer."""
        self._answer = self._function(question)

    def line(self, wait_s: float) -> str | None:
        """Return the answer to the last question; None if the answer has already been returned."""
        answer, self._answer = self._answer, None
        return answer


class TcpLines(LinePort):
    """A program that listens at `host`:`port` and sends lines, either when asked or on its own."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"tcp:{host}:{port}")
        self._at = (host, port)
        self._socket: socket.socket | None = None
        self._stream: LineStream | None = None

    def open(self) -> str:
        """Connect or reconnect; return an empty string, since there is no header line."""
        self.close()
        try:
            self._socket = socket.create_connection(self._at, timeout=CONNECT_S)
        except OSError as error:
            raise InstrumentError(
                f"nothing answers at {self.name} ({error.strerror or error}). Start the tracker's program, or "
                "name its address: --tracker tcp:HOST:PORT. A simulated one is started with: sarcal controller "
                "--procedure open_loop -i loopback"
            ) from error
        self._stream = LineStream(self._socket.fileno())
        return ""

    def ask(self, question: str) -> None:
        """Discard earlier lines and send the question as a line."""
        if self._socket is None or self._stream is None:
            raise self._gone()
        self._stream.forget()
        with contextlib.suppress(OSError):  # `line` reports a closed connection
            self._socket.sendall(question.encode() + b"\n")

    def line(self, wait_s: float) -> str | None:
        """Return the next line; None if there is none within `wait_s`."""
        if self._stream is None:
            raise self._gone()
        try:
            return self._stream.line(wait_s, self.name)
        except EOFError as ended:
            raise self._gone(str(ended)) from None

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None and self._stream is not None:
            self._stream.end(self._socket)
        self._socket = self._stream = None

    def _gone(self, last: str = "") -> InstrumentError:
        self.close()
        last_line = f" Its last line: {last}." if last else ""
        return InstrumentError(
            f"the tracker at {self.name} closed the connection.{last_line} Start its program again, then go on with "
            "this session"
        )


class StdinLines(LinePort):
    """Lines that another program writes to standard input; a daemon thread reads them."""

    sends_questions = False

    def __init__(self, descriptor: int = 0) -> None:
        super().__init__("stdin")
        self._descriptor = descriptor

    @cached_property
    def _stream(self) -> LineStream:
        return LineStream(self._descriptor)

    def open(self) -> str:
        """Start reading and discard earlier lines; return an empty string, since there is no header line."""
        self._stream.forget()
        return ""

    def ask(self, question: str) -> None:
        """Discard the lines received so far; the question is not sent, since standard input only receives."""
        self._stream.forget()

    def line(self, wait_s: float) -> str | None:
        """Return the next line; None if there is none within `wait_s`."""
        try:
            return self._stream.line(wait_s, self.name)
        except EOFError:
            raise InstrumentError(
                "standard input ended: the tracker's program closed it. Keep that program running during the session: "
                "tracker-program | sarcal run open_loop --tracker stdin"
            ) from None


class GrowingFile(LinePort):
    """Lines that another program appends to a file, below a header line; the file is opened for every poll."""

    sends_questions = False

    def __init__(self, path: Path) -> None:
        super().__init__(f"file:{path}")
        self._path, self._at = path, 0
        self._skip_next = False

    def open(self) -> str:
        """Return the header line; `InstrumentError` if it is not complete yet."""
        with self._open_regular_file() as file:
            header = file.readline(LONGEST)
        if not header.endswith(b"\n"):
            raise InstrumentError(
                f"{self._path} has no header line yet. The first line must name the columns: x_m,y_m,z_m and, for the "
                "orientation, for example rx_deg,ry_deg,rz_deg"
            )
        return header.decode(errors="replace").strip("\r\n\ufeff")

    def ask(self, question: str) -> None:
        """Discard the rows present now, including an incomplete last row: `line` returns only rows begun after this."""
        self._at = self._size()
        self._skip_next = False
        if self._at:
            with self._open_regular_file() as file:
                file.seek(self._at - 1)
                self._skip_next = file.read(1) != b"\n"

    def line(self, wait_s: float) -> str | None:
        """Return the next whole row; None if there is none within `wait_s`."""
        until_s = time.monotonic() + wait_s
        while True:
            if row := self._next():
                return row
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                return None
            time.sleep(min(FILE_POLL_S, left_s))

    def _next(self) -> str:
        if self._size() < self._at:
            raise InstrumentError(
                f"{self._path} has become shorter: it was overwritten. Have the tracker's program append rows "
                "to it, then go on with this session"
            )
        with self._open_regular_file() as file:
            file.seek(self._at)
            row = file.readline(LONGEST)
        if not row.endswith(b"\n"):
            require_short(len(row), self.name)
            return ""
        self._at += len(row)
        skip, self._skip_next = self._skip_next, False
        return "" if skip else row.decode(errors="replace").strip("\r\n")

    @contextmanager
    def _open_regular_file(self) -> Iterator[BinaryIO]:
        """Open the file; `InstrumentError` unless it is a regular file (a pipe could block)."""
        try:
            with open(
                self._path, "rb", opener=lambda path, flags: os.open(path, flags | os.O_NONBLOCK)
            ) as file:
                if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                    raise self._no_file()
                yield file
        except IsADirectoryError as error:
            raise self._no_file() from error
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            raise InstrumentError(
                f"{self._path} cannot be read ({reason}). Let the tracker's program write "
                "the header line first: x_m,y_m,z_m and, for the orientation, for example rx_deg,ry_deg,rz_deg"
            ) from error

    def _no_file(self) -> InstrumentError:
        return InstrumentError(
            f"{self._path} is a folder, a pipe or a device, not a file. Name a file that the tracker's "
            "program appends rows to; for a pipe use --tracker stdin"
        )

    def _size(self) -> int:
        try:
            return self._path.stat().st_size
        except OSError as error:
            raise InstrumentError(
                f"{self._path} is gone ({error.strerror or error}). Let the tracker's program write it again, "
                "then go on with this session"
            ) from error

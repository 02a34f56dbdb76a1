"""Lines of text from an instrument: a TCP port, standard input, or a file that grows. Knows no line's meaning.

What an instrument said before it was asked is of another pose, and forgotten. Where there is a way back
the question goes there as a line of its own; an instrument that takes no questions may ignore it.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Protocol

from hardware.errors import InstrumentError
from hardware.line_stream import LONGEST, LineStream, require_short

CONNECT_S = 3.0
"""How long a port may take to answer at all."""
LOOK_S = 0.05
"""How often a file is looked at."""


class LinePort(Protocol):
    """Where an instrument's lines come from. Calls come from one thread; `InstrumentError` says what is wrong."""

    @property
    def name(self) -> str:
        """What it is, in the words it was asked for."""

    def open(self) -> str:
        """Connect; the first line where that is a heading, else nothing."""

    def ask(self, question: str) -> None:
        """Forget what came until now, and ask."""

    def line(self, wait_s: float) -> str | None:
        """Return the next whole line since `ask`; None when there is none within `wait_s`."""

    def close(self) -> None:
        """Let go of it. Safe to call twice."""


class CalledLines:
    """An instrument of this process: a function from question to answer."""

    def __init__(self, answer: Callable[[str], str], name: str) -> None:
        self._answer, self._name = answer, name
        self._said: str | None = None

    @property
    def name(self) -> str:
        """As given."""
        return self._name

    def open(self) -> str:
        """Nothing to do."""
        return ""

    def ask(self, question: str) -> None:
        """Ask it."""
        self._said = self._answer(question)

    def line(self, wait_s: float) -> str | None:
        """Return its answer, once."""
        said, self._said = self._said, None
        return said

    def close(self) -> None:
        """Nothing to do."""


class TcpLines:
    """A program that listens at `host`:`port` and sends lines, asked or not."""

    def __init__(self, host: str, port: int) -> None:
        self._at = (host, port)
        self._socket: socket.socket | None = None
        self._stream: LineStream | None = None

    @property
    def name(self) -> str:
        """``tcp:HOST:PORT``."""
        return f"tcp:{self._at[0]}:{self._at[1]}"

    def open(self) -> str:
        """Connect, anew where it was connected."""
        self.close()
        try:
            self._socket = socket.create_connection(self._at, timeout=CONNECT_S)
        except OSError as error:
            raise InstrumentError(
                f"nothing answers at {self.name} ({error.strerror or error}). Start the tracker's program, or "
                "say where it listens: --tracker tcp:HOST:PORT. A simulated one comes with: sarcal controller "
                "--procedure open_loop -i loopback"
            ) from error
        self._stream = LineStream(self._socket.fileno())
        return ""

    def ask(self, question: str) -> None:
        """Throw away what has come, send the question."""
        if self._socket is None or self._stream is None:
            raise self._gone()
        self._stream.forget()
        # Of one that has gone, `line` says it, with its last words.
        with contextlib.suppress(OSError):
            self._socket.sendall(question.encode() + b"\n")

    def line(self, wait_s: float) -> str | None:
        """Return the next line."""
        if self._stream is None:
            raise self._gone()
        try:
            return self._stream.line(wait_s, self.name)
        except EOFError as ended:
            raise self._gone(str(ended)) from None

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None and self._stream is not None:
            self._stream.end(self._socket)
        self._socket = self._stream = None

    def _gone(self, last: str = "") -> InstrumentError:
        self.close()
        said = f" Its last line: {last}." if last else ""
        return InstrumentError(
            f"the tracker at {self.name} hung up.{said} Start its program again, then go on with this session"
        )


class StdinLines:
    """Lines that another program writes into this one's standard input."""

    def __init__(self, descriptor: int = 0) -> None:
        self._descriptor = descriptor
        self._stream: LineStream | None = None

    @property
    def name(self) -> str:
        """``stdin``."""
        return "stdin"

    def open(self) -> str:
        """Begin to read."""
        self._read()
        return ""

    def ask(self, question: str) -> None:
        """Throw away what has come."""
        self._read().forget()

    def line(self, wait_s: float) -> str | None:
        """Return the next line."""
        try:
            return self._read().line(wait_s, self.name)
        except EOFError:
            raise InstrumentError(
                "standard input ended: no tracker writes into it any more. Let its program run as long as the "
                "session: tracker-program | sarcal run open_loop --tracker stdin"
            ) from None

    def close(self) -> None:
        """Nothing to do: the reader ends with the program."""

    def _read(self) -> LineStream:
        self._stream = self._stream or LineStream(self._descriptor)
        return self._stream


class GrowingFile:
    """Lines that another program adds to the end of a file, below a heading."""

    def __init__(self, path: Path) -> None:
        self._path, self._at = path, 0
        self._begun_before = False

    @property
    def name(self) -> str:
        """``file:PATH``."""
        return f"file:{self._path}"

    def open(self) -> str:
        """Return the heading."""
        with self._opened() as file:
            heading = file.readline(LONGEST)
        if not heading.endswith(b"\n"):
            raise InstrumentError(
                f"{self._path} has no heading yet. Its first line names the columns: x_m,y_m,z_m and how "
                "the target is turned"
            )
        return heading.decode(errors="replace").strip("\r\n\ufeff")

    def ask(self, question: str) -> None:
        """Count from where the file ends now; a row that is half written was begun before."""
        self._at = self._size()
        self._begun_before = False
        if self._at:
            with self._opened() as file:
                file.seek(self._at - 1)
                self._begun_before = file.read(1) != b"\n"

    def line(self, wait_s: float) -> str | None:
        """Return the next row that is whole."""
        until_s = time.monotonic() + wait_s
        while True:
            found = self._next()
            if found:
                return found
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                return None
            time.sleep(min(LOOK_S, left_s))

    def close(self) -> None:
        """Nothing to do: it is opened for every look."""

    def _next(self) -> str:
        if self._size() < self._at:
            raise InstrumentError(
                f"{self._path} has become shorter: it was written anew. Let the tracker's program add rows "
                "to it, then go on with this session"
            )
        with self._opened() as file:
            file.seek(self._at)
            found = file.readline(LONGEST)
        if not found.endswith(b"\n"):
            require_short(len(found), self.name)
            return ""
        self._at += len(found)
        skipped, self._begun_before = self._begun_before, False
        return "" if skipped else found.decode(errors="replace").strip("\r\n")

    @contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        """Open the file; a pipe would keep us waiting for whoever writes to it, and cannot be looked back into."""
        try:
            descriptor = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            with os.fdopen(descriptor, "rb") as file:
                if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                    raise self._no_file()
                yield file
        except IsADirectoryError as error:
            raise self._no_file() from error
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else str(error)
            raise InstrumentError(
                f"{self._path} cannot be read ({why}). Let the tracker's program write "
                "its heading first: x_m,y_m,z_m and how the target is turned"
            ) from error

    def _no_file(self) -> InstrumentError:
        return InstrumentError(
            f"{self._path} is no file but a folder, a pipe or a device. Name a file that the tracker's "
            "program adds rows to; what comes through a pipe: --tracker stdin"
        )

    def _size(self) -> int:
        try:
            return self._path.stat().st_size
        except OSError as error:
            raise InstrumentError(
                f"{self._path} is gone ({error.strerror or error}). Let the tracker's program write it again, "
                "then go on with this session"
            ) from error

"""A program in a pseudo-terminal, with time stamps of its output. Linux only."""

import fcntl
import os
import pty
import select
import struct
import subprocess
import termios
import threading
import time
from collections.abc import Sequence
from pathlib import Path

WALK = [
    (b"\r", "goes on to Fixture"),
    (b"\r", "Check list"),
    (b"\r", "goes on to Modes"),
    (b"\r", "Ranked"),
    (b"\r", "Apply the modes?"),
    (b"y", "goes on to Capture"),
    (b"\r", "What the poses determine"),
    (b"\r", "ANY KEY STOPS"),
]
"""From Connect to automatic capture: keys and the text that each one shows."""


class PtyProgram:
    def __init__(self, command: Sequence[str], *, size: tuple[int, int], folder: Path) -> None:
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
        plain = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
        environment = {**plain, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
        self.process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=environment,
            start_new_session=True,
        )  # fmt: skip
        os.close(slave)
        self._reading = True
        self._news = threading.Condition()
        self._chunks: list[tuple[float, bytes]] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while self._reading:
            if not select.select([self._master], [], [], 0.05)[0]:
                continue
            try:
                data = os.read(self._master, 65536)
            except OSError:
                data = b""
            now = time.monotonic()
            with self._news:
                if not data:
                    return
                self._chunks.append((now, data))
                self._news.notify_all()

    def write(self, keys: bytes) -> float:
        """Press keys; return the time (monotonic)."""
        now = time.monotonic()
        os.write(self._master, keys)
        return now

    def mark(self) -> int:
        with self._news:
            return len(self._chunks)

    def seen(self, text: str, since: int, patience_s: float = 60.0) -> float:
        """Return the time (monotonic) at which `text` was written after the position `since`."""
        text_bytes = text.encode()
        end = time.monotonic() + patience_s
        at, tail = since, b""
        with self._news:
            while True:
                while at < len(self._chunks):
                    when, data = self._chunks[at]
                    at += 1
                    tail = (tail + data)[-65536:]
                    if text_bytes in tail:
                        return when
                if not self._news.wait(end - time.monotonic()):
                    raise TimeoutError(f"never written: {text}\n{tail[-3000:]!r}")

    def press(self, keys: bytes, text: str, patience_s: float = 60.0) -> float:
        """Press keys and wait for a text; return the delay, s."""
        mark = self.mark()
        pressed = self.write(keys)
        return self.seen(text, mark, patience_s) - pressed

    def stop_reading(self) -> None:
        """Stop reading its output, like a terminal with a hanging connection."""
        self._reading = False

    def close_terminal(self) -> None:
        """Close the terminal like a closed window, without sending signals."""
        self._reading = False
        self._reader.join()  # a pending read would keep it open
        os.close(self._master)
        self._master = -1

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(60)
        if self._master >= 0:
            self.close_terminal()

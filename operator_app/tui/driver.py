"""The terminal driver, which detects STOP in the reading thread and survives the loss of the terminal.

A repaint or a calibration may block the event loop for some hundredths of a second. STOP does not wait for the event
loop, because keys are examined in the thread that reads them. Errors of writing to a closed terminal are ignored.
Otherwise they would end the thread that writes, and the app would wait for this thread forever with the arm enabled.
"""

import contextlib
from collections.abc import Callable
from typing import IO, Any

from textual import events
from textual.driver import Driver
from textual.message import Message

Pressed = events.Key | events.MouseDown


def watched(driver: type[Driver], stop_on_input: Callable[[Pressed], None]) -> type[Driver]:
    """Return a driver class that passes key and mouse presses to `stop_on_input` first and ignores write errors."""

    class WatchedDriver(driver):  # type: ignore[misc, valid-type]
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            file: IO[str] | None = getattr(self, "_file", None)
            if file is not None:
                self._file: Any = _MayBeGone(file)

        def process_message(self, message: Message) -> None:
            if isinstance(message, events.Key | events.MouseDown):
                stop_on_input(message)
            super().process_message(message)

    return WatchedDriver


class _MayBeGone:
    def __init__(self, file: IO[str]) -> None:
        self._file = file

    def write(self, text: str) -> None:
        with contextlib.suppress(OSError):
            self._file.write(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self._file.flush()

    def fileno(self) -> int:
        return self._file.fileno()

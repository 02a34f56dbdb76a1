"""STOP at the door: keys are looked at in the thread that reads them, before the event loop has a turn.

A repaint or a calibration may keep the loop for some hundredths of a second; STOP does not wait for it.
"""

from __future__ import annotations

from collections.abc import Callable

from textual import events
from textual.driver import Driver
from textual.message import Message


def watched(driver: type[Driver], at_the_door: Callable[[events.Key], None]) -> type[Driver]:
    """Return the driver class with a look at every key as it is read."""

    class WatchedDriver(driver):  # type: ignore[misc, valid-type]
        """See `watched`."""

        def process_message(self, message: Message) -> None:
            """Look, then pass it on."""
            if isinstance(message, events.Key):
                at_the_door(message)
            super().process_message(message)

    return WatchedDriver

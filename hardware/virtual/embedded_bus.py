"""The bus between an operator and the virtual arm of its own process. Knows frames; no node and no arm."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import can
from can.interfaces.virtual import VirtualBus

from hardware.bus_setup import BusOpeners
from hardware.virtual.controller import VirtualController

_SENT = can.Message()
"""In the queue of a bus whose reader sleeps: something has been sent, and the arm may have an answer."""


class AttendingBus(VirtualBus):
    """Virtual bus whose reader lets the arm at its other end live while nothing has come.

    A reader that sleeps when another thread sends is woken: what was asked is answered at once.

    Parameters
    ----------
    channel
        As in python-can.
    attend
        Called when a frame is waited for and none is there: `VirtualController.attend`.
    """

    def __init__(self, channel: str, attend: Callable[[], None], **kwargs: Any) -> None:
        super().__init__(channel, **kwargs)
        self._attend = attend
        self._awaited = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, and wake the reader."""
        super().send(msg, timeout)
        if self._awaited:
            self.queue.put(_SENT)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        until = None if timeout is None else time.monotonic() + timeout
        # Set before the arm is attended: what is sent while it is would else wait for the time-out.
        self._awaited = True
        try:
            while True:
                if self.queue.empty():
                    self._attend()
                left = None if until is None else max(0.0, until - time.monotonic())
                message, filtered = super()._recv_internal(left)
                if message is not _SENT:
                    return message, filtered
        finally:
            self._awaited = False


def attending(controller: VirtualController) -> BusOpeners:
    """Return how an operator in this process opens the bus of an `attended` controller."""
    return BusOpeners(main=lambda settings: AttendingBus(settings.channel, controller.attend))

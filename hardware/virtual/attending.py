"""The bus between an operator and the virtual arm of its own process. Knows frames; no node and no arm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import can
from can.interfaces.virtual import VirtualBus

from hardware.connection import BusOpeners
from hardware.virtual.controller import VirtualController


class AttendingBus(VirtualBus):
    """Virtual bus whose reader lets the arm at its other end live while nothing has come.

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

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.queue.empty():
            self._attend()
        return super()._recv_internal(timeout)


def attending(controller: VirtualController) -> BusOpeners:
    """Return how an operator in this process opens the bus of an `attended` controller."""
    return BusOpeners(main=lambda settings: AttendingBus(settings.channel, controller.attend))

"""The bus between an operator and the virtual arm in the same process."""

import queue
import time
from collections.abc import Callable
from copy import copy
from typing import cast

import can
from can.interfaces.virtual import VirtualBus, channels_lock

from hardware.buses.python_can import BusSettings
from hardware.timed_queue import TimedQueue
from hardware.virtual.controller import VirtualController

_SENT = can.Message()
"""Marker put into a reader's queue to wake the reader after a frame was sent that the arm may answer."""


class EmbeddedBus(VirtualBus):
    """Replacement for python-can's virtual bus, on the same channels, at a third of the processor time.

    It uses a `TimedQueue` (based on a queue in C), shares one copy of each frame, and has no filters.
    """

    def __init__(self, channel: str) -> None:
        super().__init__(channel)
        simple = cast("queue.Queue[can.Message]", TimedQueue())
        with channels_lock:
            self.channel[self.channel.index(self.queue)] = simple
            self.queue = simple

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to all others on the channel."""
        self._check_if_open()
        shared = copy(msg)
        shared.timestamp = time.time()
        shared.channel = self.channel_id
        shared.is_rx = True
        for listener in self.channel:
            if listener is not self.queue:
                listener.put(shared, timeout=timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame; None after `timeout` seconds."""
        message, _ = self._recv_internal(timeout)
        return message


class AttendingBus(EmbeddedBus):
    """Embedded bus whose readers run the virtual arm while they wait for a frame.

    A reader that finds no frame in the queue calls `attend` (`VirtualController.attend`) before it waits. If another
    thread sends a frame meanwhile, the reader wakes and calls `attend` again.
    """

    def __init__(self, channel: str, attend: Callable[[], None]) -> None:
        super().__init__(channel)
        self._attend = attend
        self._awaited = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, and wake a reader that waits for a frame."""
        super().send(msg, timeout)
        if self._awaited:
            self.queue.put(_SENT)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame; None after `timeout` seconds."""
        until = None if timeout is None else time.monotonic() + timeout
        # Set before `attend`, so that a frame sent while it runs wakes the reader before the time-out.
        self._awaited = True
        try:
            while True:
                if self.queue.empty():
                    self._attend()
                remaining_s = None if until is None else max(0.0, until - time.monotonic())
                message = super().recv(remaining_s)
                if message is not _SENT:
                    return message
        finally:
            self._awaited = False


def attended_opener(controller: VirtualController) -> Callable[[BusSettings], can.BusABC]:
    """Return the bus opener for an operator in the process of `controller`, which was made with ``attended=True``."""
    return lambda settings: AttendingBus(settings.channel, controller.attend)

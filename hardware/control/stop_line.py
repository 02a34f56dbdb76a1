"""STOP: its latch, and its separate path to the drives through a second handle on the bus, without locks."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Final

import can

from hardware.arm import JointMode
from hardware.buses.shared_bus import SharedBus, queue_is_full
from hardware.canopen.cia402 import CONTROLWORD_QUICK_STOP
from hardware.canopen.cyclic import JointFrames, Setpoint, Setpoints
from hardware.canopen.objects import CONTROL_PERIOD_S
from hardware.errors import BusError
from hardware.monitors.following import Divergence


class _Press:
    """One press of STOP; `cause` is the uncommanded motion that led to it, or None."""

    def __init__(self, cause: Divergence | None) -> None:
        self.cause: Final = cause


class StopLatch:
    """Latch of STOP, which outlives a connection. `release` releases only the press passed to it, not a later one.

    The latch has no lock: `press` and `release` write one attribute each, so a simultaneous press is not lost.
    """

    def __init__(self) -> None:
        self._pressed: _Press | None = None
        self._released: object | None = None

    @property
    def latched(self) -> bool:
        """Whether STOP was pressed since the last release."""
        return self._pressed is not self._released

    @property
    def last_press(self) -> object | None:
        """The latest press of STOP, as `release` requires it; None before the first press."""
        return self._pressed

    @property
    def cause(self) -> Divergence | None:
        """Uncommanded motion for which STOP is latched; None if a person pressed STOP, or STOP is not latched."""
        pressed = self._pressed
        return None if pressed is None or pressed is self._released else pressed.cause

    def press(self, cause: Divergence | None = None) -> None:
        """Latch STOP. May be called from any thread; while STOP is latched, a further press keeps the first cause."""
        self._pressed = _Press(self.cause or cause)

    def release(self, press: object | None) -> bool:
        """Release the latch if `press` is the latest press; return whether the latch is released."""
        if self._pressed is press:
            self._released = press
        return not self.latched


class StopLine:
    """Sends quick stop to all drives.

    `bus` is a handle that only STOP uses, and that `close` shuts down; None if the adapter can be opened only once.
    `spare` is the shared handle, whose lock STOP does not take. Frames that `bus` does not accept, or all frames if
    `bus` is None, are sent through `spare`. Every frame that STOP sends is recorded there.
    """

    def __init__(
        self, bus: can.BusABC | None, spare: SharedBus, frames: Sequence[JointFrames]
    ) -> None:
        self._bus, self._spare, self._frames = bus, spare, tuple(frames)
        own = () if bus is None else (partial(bus.send, timeout=0.0),)
        self._ways: tuple[Callable[[can.Message], None], ...] = (*own, spare.send_at_once)

    def send(self, last: Setpoints | None, counts: Sequence[int]) -> None:
        """Send quick stop to every drive, together with the drive's target and mode from `last`.

        If `last` is None, the targets are the positions `counts`. Raises `BusError` if a frame could not be
        sent; all other frames were sent.
        """
        failure: Exception | None = None
        deadline_s = time.monotonic() + CONTROL_PERIOD_S
        sent: list[can.Message] = []
        frames: list[tuple[int, bytes]] = []
        for at, measured in enumerate(counts):
            target = last[at].target_counts if last else measured
            mode = last[at].mode if last else JointMode.POSITION
            stop = Setpoint(CONTROLWORD_QUICK_STOP, target, mode)
            frames += self._frames[at].pack_controlword(stop)
        for identifier, data in frames:
            message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
            message.timestamp = time.time()
            problem = self._send_one(message)
            # A full queue empties within a millisecond; other errors are final.
            while problem is not None and queue_is_full(problem) and time.monotonic() < deadline_s:
                problem = self._send_one(message)
            if problem is None:
                sent.append(message)
            failure = problem or failure
        for message in sent:
            self._spare.note_sent(message)
        if failure is not None:
            text = str(failure).rstrip(".")
            raise BusError(f"STOP could not be sent: {text}. Use the emergency stop.") from failure

    def _send_one(self, message: can.Message) -> Exception | None:
        problem: Exception | None = None
        for way in self._ways:
            try:
                way(message)
            except Exception as error:  # noqa: BLE001 - drivers raise anything; try the other handle
                problem = error
            else:
                return None
        return problem

    def close(self) -> None:
        """Shut the handle down."""
        if self._bus is not None:
            with suppress(Exception):  # an unplugged adapter cannot be closed
                self._bus.shutdown()

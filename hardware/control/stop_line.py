"""STOP: its latch, and its own way to the drives by a second handle on the bus. Takes no lock, knows no loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import can

from hardware.buses.shared_bus import SharedBus, queue_is_full
from hardware.canopen.cia402 import CONTROLWORD_QUICK_STOP
from hardware.canopen.cyclic import JointFrames, Setpoint, Setpoints
from hardware.canopen.objects import CONTROL_PERIOD_S, CYCLIC_POSITION
from hardware.errors import BusError
from hardware.monitors.following import Divergence


class _Press:
    """One press of STOP, and the joint that went astray, if that was why."""

    def __init__(self, why: Divergence | None) -> None:
        self.cause: Final = why


class StopLatch:
    """Whether STOP is latched, and by which press: a reset lifts only the STOP it was asked for.

    It outlives a connection, and so does why it was latched.

    Each side writes one name only, so that no press is lost between a look and a write; without a
    lock, since STOP waits for nothing.
    """

    def __init__(self) -> None:
        self._pressed: _Press | None = None
        self._released: object | None = None

    @property
    def latched(self) -> bool:
        """Whether STOP was pressed after what was released last."""
        return self._pressed is not self._released

    @property
    def last_press(self) -> object | None:
        """The latest press, for `release`; None before the first."""
        return self._pressed

    @property
    def cause(self) -> Divergence | None:
        """The joint that went astray, for which this is latched; None where a person pressed it, or it is not."""
        pressed = self._pressed
        return None if pressed is None or pressed is self._released else pressed.cause

    def press(self, why: Divergence | None = None) -> None:
        """Latch, for a joint that went `why` astray. From any thread; a second press keeps the first one's cause."""
        self._pressed = _Press(self.cause or why)

    def release(self, press: object | None) -> bool:
        """Lift the latch if nothing was pressed after `press`; whether it is lifted."""
        if self._pressed is press:
            self._released = press
        return not self.latched


class StopLine:
    """Sends quick stop to all drives.

    Parameters
    ----------
    bus
        Handle that nobody else sends on; `close` shuts it down. None where an adapter opens only once:
        then STOP goes out by the one handle there is, past its lock.
    spare
        Where a frame goes that the handle does not take; it records what was sent.
    frames
        Of joints 1..n.
    """

    def __init__(
        self, bus: can.BusABC | None, spare: SharedBus, frames: Sequence[JointFrames]
    ) -> None:
        self._bus, self._spare, self._frames = bus, spare, tuple(frames)
        own = () if bus is None else (partial(bus.send, timeout=0.0),)
        self._ways: tuple[Callable[[can.Message], None], ...] = (*own, spare.send_at_once)

    def send(self, given: Setpoints | None, counts: Sequence[int]) -> None:
        """Quick stop to every drive; target and mode stay what they were.

        Parameters
        ----------
        given
            Setpoints sent last, None if there were none.
        counts
            Positions, one for each joint.

        Raises
        ------
        BusError
            If a frame could not be sent at all; the others were.
        """
        failure: Exception | None = None
        deadline_s = time.monotonic() + CONTROL_PERIOD_S
        sent: list[can.Message] = []
        frames: list[tuple[int, bytes]] = []
        for at, measured in enumerate(counts):
            target = given[at].target_counts if given else measured
            mode = given[at].mode if given else CYCLIC_POSITION
            stop = Setpoint(CONTROLWORD_QUICK_STOP, target, mode)
            frames += self._frames[at].pack_controlword(stop)
        for identifier, data in frames:
            message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
            message.timestamp = time.time()
            problem = self._send_one(message)
            # A full queue empties within a millisecond; a bus that takes nothing is tried once.
            while problem is not None and queue_is_full(problem) and time.monotonic() < deadline_s:
                problem = self._send_one(message)
            if problem is None:
                sent.append(message)
            failure = problem or failure
        for message in sent:
            self._spare.note_sent(message)
        if failure is not None:
            words = str(failure).rstrip(".")
            raise BusError(f"STOP could not be sent: {words}. Use the emergency stop.") from failure

    def _send_one(self, message: can.Message) -> Exception | None:
        """Send a frame by the first way that takes it; return why none did."""
        problem: Exception | None = None
        for way in self._ways:
            try:
                way(message)
            except Exception as error:  # noqa: BLE001 - whatever a driver raises, the drive gets its frame
                problem = error
            else:
                return None
        return problem

    def close(self) -> None:
        """Shut the handle down."""
        if self._bus is not None:
            self._bus.shutdown()

"""Has a connection to an arm, one at a time: made whole or not at all, let go with the arm held. Knows no motion.

STOP finds the arm at every moment, while it is being connected and while it is being closed too.
"""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path

from hardware.arm import ArmIdentity, DriveState
from hardware.bus_setup import ArmOnBus
from hardware.control.connection import Connection
from hardware.control.release import ReleaseResult, release_arm
from hardware.control.stop_line import StopLatch
from hardware.errors import BusError, HardwareError


class Connector:
    """Connects to one arm, and lets go of it.

    Parameters
    ----------
    on_bus
        The arm expected, and how it is talked to.
    record_to
        File to record the bus to; None for none.

    Attributes
    ----------
    record_to
        As above: of the next connection.
    latch
        Of STOP: it outlives a connection, so that a new one does not lift a STOP.
    takes_over
        Whether drives that are found enabled were left so, by this program itself or by what somebody asked to
        take over: of the next connection only, made or not.
    """

    def __init__(self, on_bus: ArmOnBus, record_to: Path | None) -> None:
        self._on_bus, self.record_to = on_bus, record_to
        self.latch = StopLatch()
        self.takes_over = False
        self._connection: Connection | None = None
        self._opening: Connection | None = None
        self._connecting = False
        self._recording_failure: str | None = None
        self._closing = False
        self._left = ReleaseResult(held=True)
        self._close_lock = threading.RLock()

    @property
    def connection(self) -> Connection:
        """The present one; BusError without."""
        link = self._connection
        if link is None:
            raise BusError("The arm is not connected.")
        return link

    @property
    def recording_failure(self) -> str | None:
        """Why the recording of the bus ended early, of the last connection too; None if it did not."""
        link = self._connection
        return self._recording_failure if link is None else link.recording_failure

    def connect(self) -> ArmIdentity:
        """Open a connection; what goes wrong closes it again. A STOP pressed meanwhile ends this."""
        if self._connection is not None:
            raise ValueError("this arm is connected already")
        press, self._connecting = self.latch.last_press, True
        try:
            self._opening = connection = Connection(
                self._on_bus, record_to=self.record_to, latch=self.latch
            )
            # For this one alone: who enables drives later is not known.
            takes_over, self.takes_over = self.takes_over, False
            try:
                identity = connection.open(press, takes_over=takes_over)
            except BaseException:
                connection.close()
                raise
            self._connection = connection
            return identity
        finally:
            self._connecting, self._opening = False, None

    def close(self) -> bool:
        """Let go; False if there was an arm and it did not answer, or some drive follows commands still.

        From any thread; a second one waits.
        """
        with self._close_lock:
            link = self._connection
            if link is None or self._closing:  # closing: called again by the thread that closes
                return self._left.held
            self._closing, self._left = True, ReleaseResult(held=False)
            try:
                self._left = self._let_go(link)
            finally:
                # Not before: STOP needs the connection to the last moment.
                self._connection, self._closing = None, False
            return self._left.held

    @property
    def left_powered(self) -> tuple[int, ...]:
        """Joints whose drives said that they were powered when the arm was let go of last."""
        return self._left.powered

    def drop(self) -> None:
        """End the connection and leave the drives as they are."""
        link, self._connection = self.connection, None
        self._left = ReleaseResult(held=False)
        self._end(link)

    def look(self) -> tuple[DriveState, ...]:
        """State of every drive (6041h), by SDO alone: nothing is reset, and no heartbeat or SYNC sent."""
        if self._connection is not None:
            raise ValueError("this arm is connected: its snapshot says it")
        link = Connection(self._on_bus, record_to=None, latch=self.latch)
        try:
            return link.read_states()
        finally:
            link.close()

    def stop(self) -> None:
        """Latch STOP, and send it if the bus is open by then; BusError without an arm, or if it could not be sent."""
        # In this order: connecting, an arm is there as `_opening` until it is there as `_connection`.
        connecting, link = self._connecting, self._opening or self._connection
        if link is None and not connecting:
            raise BusError("The arm is not connected.")
        self.latch.press()
        if link is not None:
            link.send_quick_stops()

    def _let_go(self, link: Connection) -> ReleaseResult:
        """Hold, disable, look, give the token back."""
        try:
            if not link.in_control:
                return ReleaseResult(held=not link.is_lost())
            left = release_arm(link.loop)
            with contextlib.suppress(HardwareError):  # it lapses with the heartbeat
                link.give_token_back()
            return left
        finally:
            self._end(link)

    def _end(self, link: Connection) -> None:
        self.takes_over = link.left_enabled
        link.close()
        self._recording_failure = link.recording_failure

"""Opens one connection to an arm at a time, and releases the arm: holding, drives off, state verified.

STOP reaches the arm at any moment, also while connecting and closing. A release relies only on what the drives
report: a drive may ignore a command.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path

from hardware.arm import ArmIdentity, DriveState
from hardware.buses.python_can import ArmOnBus
from hardware.canopen.cia402 import CLOSED_LOOP_STATES, TargetState, reached, state_of
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.control import motion_steps
from hardware.control.connection import Connection
from hardware.control.control_loop import ControlLoop
from hardware.control.stop_line import StopLatch
from hardware.errors import (
    BusError,
    CommandRefused,
    ControlDenied,
    DriveFault,
    DuplicateNodeId,
    HardwareError,
    NodeRestarted,
    OtherMaster,
    SensorFault,
    Stopped,
)

_IGNORED_ALARMS: tuple[type[HardwareError], ...] = (
    DriveFault,
    ControlDenied,
    SensorFault,
    OtherMaster,
    DuplicateNodeId,
    NodeRestarted,
    CommandRefused,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReleaseResult:
    """State in which an arm was left.

    Attributes
    ----------
    holding
        Whether it answered and no drive follows commands.
    powered
        Joints whose drives are still powered, including those that hold after STOP.
    """

    holding: bool
    powered: tuple[int, ...] = ()


class Connector:
    """Connects to one arm and releases it.

    Attributes
    ----------
    record_to
        File to record the next connection to; None for none.
    latch
        STOP latch; it outlives a connection, so that a new one does not lift a STOP.
    takes_over
        Whether the next connection may reset drives that are enabled: this program left them so, or the user asked for
        it.
    """

    def __init__(
        self, on_bus: ArmOnBus, record_to: Path | None, clock: Callable[[], float]
    ) -> None:
        self._on_bus, self.record_to, self._clock = on_bus, record_to, clock
        self.latch = StopLatch()
        self.takes_over = False
        self._connection: Connection | None = None
        self._opening: Connection | None = None
        self._connecting = False
        self._recording_failure: str | None = None
        self._closing = False
        self._released = ReleaseResult(holding=True)
        self._close_lock = threading.RLock()

    @property
    def connection(self) -> Connection:
        """The open connection; `BusError` if there is none."""
        link = self._connection
        if link is None:
            raise BusError("The arm is not connected.")
        return link

    @property
    def recording_failure(self) -> str | None:
        """Why the recording of this or the last connection ended early; None if it did not."""
        link = self._connection
        return self._recording_failure if link is None else link.recording_failure

    def connect(self) -> ArmIdentity:
        """Open a connection; an error, or STOP during it, closes it again."""
        if self._connection is not None:
            raise ValueError("this arm is connected already")
        press, self._connecting = self.latch.last_press, True
        try:
            self._opening = connection = Connection(
                self._on_bus, record_to=self.record_to, latch=self.latch, clock=self._clock
            )
            # For this connection only: another program may enable drives later.
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
        """Release the arm; false if it did not answer, or a drive still follows commands.

        May be called from any thread; a second call waits for the first.
        """
        with self._close_lock:
            link = self._connection
            if link is None or self._closing:  # closing: re-entered by the closing thread
                return self._released.holding
            self._closing, self._released = True, ReleaseResult(holding=False)
            try:
                self._released = self._release(link)
            finally:
                # Last: STOP needs the connection until now.
                self._connection, self._closing = None, False
            return self._released.holding

    @property
    def left_powered(self) -> tuple[int, ...]:
        """Joints whose drives reported power at the last release."""
        return self._released.powered

    def drop(self) -> None:
        """End the connection without a command to the drives."""
        link, self._connection = self.connection, None
        self._released = ReleaseResult(holding=False)
        self._end(link)

    def read_states(self) -> tuple[DriveState, ...]:
        """State of every drive (6041h) by SDO alone, without reset, heartbeat and SYNC."""
        if self._connection is not None:
            raise ValueError("this arm is connected: its snapshot has the states")
        link = Connection(self._on_bus, record_to=None, latch=self.latch, clock=self._clock)
        try:
            return link.read_states()
        finally:
            link.close()

    def stop(self) -> None:
        """Latch STOP, and send it if the bus is open; `BusError` if no arm is connected, or if it could not be sent."""
        # In this order: a connection is `_opening` until it is `_connection`.
        connecting, link = self._connecting, self._opening or self._connection
        if link is None and not connecting:
            raise BusError("The arm is not connected.")
        self.latch.press()
        if link is not None:
            link.send_quick_stops()

    def _release(self, link: Connection) -> ReleaseResult:
        """Hold, disable, verify, release the token."""
        try:
            if not link.in_control:
                return ReleaseResult(holding=not link.is_lost())
            result = release_arm(link.loop)
            with contextlib.suppress(HardwareError):  # it lapses with the heartbeat
                link.release_token()
            return result
        finally:
            self._end(link)

    def _end(self, link: Connection) -> None:
        self.takes_over = link.left_enabled
        link.close()
        self._recording_failure = link.recording_failure


def release_arm(loop: ControlLoop) -> ReleaseResult:
    """Set all joints to position mode, then switch the drives off, which blocks the valves. Lifts no STOP."""
    # A latched STOP holds the drives by itself; a stop that the supervisor reports does not. With a silent node
    # the others are still switched off.
    ignored = (*_IGNORED_ALARMS, BusError, *(() if loop.stop_latched else (Stopped,)))
    try:
        with contextlib.suppress(Stopped):  # by the latch: only quick stop is sent from now on
            if loop.commands is not None:
                loop.run(motion_steps.hold_where_it_is(loop), despite=ignored)
            loop.run(motion_steps.drive_to(loop, TargetState.DISABLED), despite=ignored)
        sample: Sample = loop.run(_until_off(loop), despite=(*_IGNORED_ALARMS, Stopped))
    except HardwareError:  # the drives hold without an operator too
        return ReleaseResult(holding=False)
    return ReleaseResult(holding=not _following(sample), powered=_powered(sample))


def _until_off(loop: ControlLoop) -> Generator[Setpoints | None, Sample, Sample]:
    """Exchange at most 50 SYNCs, until the drives report that they are off or, under STOP, stopped."""
    sample = yield None
    for _ in range(motion_steps.TRANSITION_SYNCS):
        motion_steps.raise_alarm(loop)
        if not (_following(sample) if loop.stop_latched else _powered(sample)):
            break
        sample = yield None
    return sample


def _following(sample: Sample) -> tuple[int, ...]:
    """Joints whose drives may follow a command."""
    states = enumerate(map(state_of, sample.statuswords), 1)
    return tuple(joint for joint, state in states if not reached(state, TargetState.STOPPED))


def _powered(sample: Sample) -> tuple[int, ...]:
    """Joints whose drives are powered."""
    states = enumerate(map(state_of, sample.statuswords), 1)
    return tuple(joint for joint, state in states if state in CLOSED_LOOP_STATES)

"""Opens at most one connection to an arm, and releases the arm, i.e. holds it and switches its drives off.

STOP reaches the arm at any moment, also while connecting and closing. A release relies only on what the drives
report: a drive may ignore a command.
"""

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path

from hardware import errors
from hardware.arm import ArmIdentity, DriveState
from hardware.buses.python_can import ArmOnBus
from hardware.canopen.cia402 import CLOSED_LOOP_STATES, POWERED_STATES, TargetState, state_of
from hardware.canopen.cyclic import Sample
from hardware.canopen.objects import STATUSWORD
from hardware.control import motion_steps
from hardware.control.connection import Connection
from hardware.control.control_loop import ControlLoop, Steps
from hardware.control.start_up import StartUp
from hardware.control.stop_line import StopLatch

_IGNORED_ALARMS: tuple[type[errors.HardwareError], ...] = (
    errors.DriveFault,
    errors.ControlDenied,
    errors.SensorFault,
    errors.OtherMaster,
    errors.DuplicateNodeId,
    errors.NodeRestarted,
    errors.CommandRefused,
)


class ConnectableArm:
    """An arm on a CAN bus that can be connected, stopped and released."""

    def __init__(
        self,
        on_bus: ArmOnBus,
        *,
        record_to: Path | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.on_bus, self._clock = on_bus, clock
        self.record_to = record_to
        """File to record the bus to (``.blf`` or another format of python-can) from the next connection on; None: no
        recording."""
        self.joints = len(on_bus.description.joints)
        self.left_powered: tuple[int, ...] = ()
        """Joints whose drives reported power when the arm was last closed, including drives that hold after STOP."""
        self._latch = StopLatch()  # outlives a connection: a new one does not lift a STOP
        self._takes_over = False
        self._connection: Connection | None = None
        self._opening: Connection | None = None
        self._connecting = False
        self._recording_failure: str | None = None
        self._closing, self._left_held = False, True
        self._close_lock = threading.RLock()

    @property
    def _link(self) -> Connection:
        link = self._connection
        if link is None:
            raise errors.BusError("The arm is not connected.")
        return link

    @property
    def recording_failure(self) -> str | None:
        """Why the recording ended early (for example a full disk); None if it did not."""
        link = self._connection
        return self._recording_failure if link is None else link.wire.recording_failure

    @property
    def found_powered(self) -> dict[int, DriveState]:
        """State, by joint, of each drive that had power before the start-up although no operator was heard."""
        return dict(self._link.found_powered)

    def take_over(self) -> None:
        """Allow the next connection to reset drives that stay enabled although no operator's heartbeat is heard."""
        self._takes_over = True

    def connect(self) -> ArmIdentity:
        """Find the nodes, check that they are the expected arm, and start heartbeats and SYNC.

        A STOP latched before the call remains latched; a STOP pressed during the call cancels the connection.
        After an error, the connection is closed again.
        """
        if self._connection is not None:
            raise ValueError("this arm is connected already")
        press, self._connecting = self._latch.last_press, True
        try:
            self._opening = connection = self._unopened(self.record_to)
            # For this connection only: another program may enable drives later.
            takes_over, self._takes_over = self._takes_over, False
            try:
                identity = StartUp(connection).run(press, takes_over=takes_over)
            except BaseException:
                connection.close()
                raise
            self._connection = connection
            return identity
        finally:
            self._connecting, self._opening = False, None

    def close(self) -> bool:
        """Hold the arm, switch its drives off, release control, and end heartbeats and recording.

        May be called twice, by any thread. Returns false if the arm did not answer or a drive still follows commands.
        """
        with self._close_lock:
            link = self._connection
            if link is None or self._closing:  # closing: re-entered by the closing thread
                return self._left_held
            self._closing, self._left_held, self.left_powered = True, False, ()
            try:
                self._release(link)
            finally:
                # Not before: STOP needs the connection until it is closed.
                self._connection, self._closing = None, False
            return self._left_held

    def stop(self) -> None:
        """Send quick stop to all drives and latch STOP. May be called from any thread; waits for no lock and no queue.

        STOP also ends a connection attempt. Raises `BusError` if no arm is connected, or if a frame could not be sent
        (all other frames were sent).
        """
        # In this order: a connection is `_opening` until it is `_connection`.
        connecting, link = self._connecting, self._opening or self._connection
        if link is None and not connecting:
            raise errors.BusError("The arm is not connected.")
        self._latch.press()
        if link is not None:
            link.send_quick_stops()

    def fall_silent(self) -> None:
        """End heartbeat, SYNC and connection without a command to the drives, as if this program had crashed."""
        link, self._connection = self._link, None
        self._left_held, self.left_powered = False, ()
        self._end(link)

    def read_states_unconnected(self) -> tuple[DriveState, ...]:
        """Read the drive states of joints 1..n by SDO (6041h) alone, without a connection; nothing is commanded."""
        if self._connection is not None:
            raise ValueError("this arm is connected: its snapshot has the states")
        link = self._unopened(None)
        try:
            link.loop.start()
            words = (link.access.read_unsigned(node, STATUSWORD) for node in link.profile.drives)
            return tuple(map(state_of, words))
        finally:
            link.close()

    def _unopened(self, record_to: Path | None) -> Connection:
        return Connection(self.on_bus, record_to=record_to, latch=self._latch, clock=self._clock)

    def _release(self, link: Connection) -> None:
        in_control = link.in_control
        try:
            # Without control: an earlier or another program may have left drives with power.
            last = release_arm(link.loop) if in_control else link.loop.sample
            if last is not None:
                self._left_held = _stopped(last) and (in_control or not link.is_lost())
                self.left_powered = last.joints_in(CLOSED_LOOP_STATES)
            if in_control:
                with contextlib.suppress(errors.HardwareError):  # it lapses with the heartbeat
                    link.release_token()
        finally:
            self._end(link)

    def _end(self, link: Connection) -> None:
        self._takes_over = link.took_control and bool(link.loop.sample.joints_in(POWERED_STATES))
        link.close()
        self._recording_failure = link.wire.recording_failure


def release_arm(loop: ControlLoop) -> Sample | None:
    """Put all joints into position mode, then switch the drives off (valves blocked). STOP is not reset.

    While STOP is latched, drives in quick stop stay there and hold; only enabled drives are switched off. Returns the
    last sample; None if the arm did not answer.
    """
    # A latched STOP holds the drives by itself; a stop that the supervisor reports does not. If one node is silent,
    # the other drives are switched off nevertheless.
    ignored = (*_IGNORED_ALARMS, errors.BusError)
    if not loop.latch.latched:
        ignored += (errors.Stopped,)
    try:
        with contextlib.suppress(errors.Stopped):  # for the latch: then only quick stop is sent
            if loop.commands is not None:
                loop.run(motion_steps.hold_all(loop), despite=ignored)
            loop.run(motion_steps.drive_to(loop, TargetState.DISABLED), despite=ignored)
        if loop.latch.latched:
            sample = loop.run(_wait_until_off(loop), despite=(*ignored, errors.Stopped))
            loop.watch.switched_off |= set(sample.joints_in({DriveState.OPERATION_ENABLED}))
        return loop.run(_wait_until_off(loop), despite=(*_IGNORED_ALARMS, errors.Stopped))
    except errors.HardwareError:  # the drives hold without an operator too
        return None


def _wait_until_off(loop: ControlLoop) -> Steps[Sample]:
    sample = yield None
    for _ in range(motion_steps.TRANSITION_SYNCS):
        motion_steps.raise_alarm(loop)
        if _stopped(sample) if loop.latch.latched else not sample.joints_in(CLOSED_LOOP_STATES):
            break
        sample = yield None
    return sample


def _stopped(sample: Sample) -> bool:
    """Whether every drive is off or stopped, so that none follows a command."""
    return not motion_steps.not_reached(sample, TargetState.STOPPED)

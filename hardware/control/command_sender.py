"""Sends the drives their commands, or quick stop in their place.

After uncommanded motion all drives are stopped, and the joint's own drive is switched off, which blocks its
valve: such a drive does not hold. A drive that was switched off at the drive is not enabled again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from hardware.canopen.cia402 import CONTROLWORD_DISABLE_VOLTAGE
from hardware.canopen.cyclic import JointFrames, Setpoint, Setpoints
from hardware.control.stop_line import StopLatch
from hardware.monitors.joint_monitor import JointMonitor


class CommandSender:
    """Sends commands in the control loop's thread.

    STOP sends its own frames; its latch is checked before and after the commands, so that quick stop is the
    last command on the bus.

    Parameters
    ----------
    send
        Puts a frame on the bus.
    frames
        Frames of joints 1..n.
    latch, watch
        STOP latch, and the monitors of the joints.
    quick_stop
        Sends quick stop to all drives; must not wait.
    """

    def __init__(
        self,
        send: Callable[[int, bytes], None],
        frames: Sequence[JointFrames],
        *,
        latch: StopLatch,
        watch: JointMonitor,
        quick_stop: Callable[[], None],
    ) -> None:
        self._send, self._frames = send, tuple(frames)
        self._latch, self._watch, self._quick_stop = latch, watch, quick_stop
        self._sent: list[Setpoint | None] = [None] * len(self._frames)

    def send(self, commands: Setpoints, sync_count: int, *, moving: bool) -> None:
        """Send changed commands, and in turn one joint's unchanged command in case a frame was lost."""
        repeated = sync_count % len(self._frames)
        dropout = self._watch.dropout
        for joint, given in enumerate(commands):
            before, command = self._sent[joint], dropout.command(joint + 1, given)
            if command is None or (command == before and joint != repeated):
                continue
            if self._latch.latched:
                break
            if before != command and not (moving and _moves_on(before, command)):
                self._watch.expect_jerk()
            for identifier, data in self._frames[joint].pack(command):
                self._send(identifier, data)
            self._sent[joint] = command
        if self._latch.latched:
            self.stop_all(commands)

    def stop_all(self, commands: Setpoints | None) -> None:
        """Switch off the drives of `watch.switched_off`, then quick stop to all.

        Raises `BusError` if a frame could not be sent; quick stop is sent in any case by its own handle.
        """
        self._sent = [None] * len(self._frames)
        try:
            for at, command in enumerate(commands or ()):
                if at + 1 not in self._watch.switched_off:
                    continue
                off = replace(command, controlword=CONTROLWORD_DISABLE_VOLTAGE)
                # By this handle: commands from STOP's handle other than quick stop count as another master's.
                for identifier, data in self._frames[at].pack_controlword(off):
                    self._send(identifier, data)
        finally:
            self._quick_stop()


def _moves_on(before: Setpoint | None, command: Setpoint) -> bool:
    """Whether only the target changed: a move in progress."""
    return before is not None and (before.controlword, before.mode) == (
        command.controlword,
        command.mode,
    )

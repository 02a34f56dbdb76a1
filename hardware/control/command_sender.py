"""Sends the drives their commands, or quick stop in their place. Knows no thread and no pace.

A joint that goes where it was not told to, its drive saying all is well, is stopped as STOP would. To hold
does not end what such a drive does, holding is what it does wrong: it is switched off as well, which blocks
its valve. So is one that goes on after a STOP. A drive that was switched off at the drive is not switched on
again by a repetition.
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

    STOP does not come through here: it is looked at before and after the commands, so that the last word on
    the bus is quick stop.

    Parameters
    ----------
    send
        Puts a frame on the bus.
    frames
        Of joints 1..n.
    latch
        Of STOP.
    watch
        Hears what may make a joint jerk, and knows those that went astray and the drives that left.
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
        """Send what changed, and one joint's command again in turn in case a frame was lost."""
        again = sync_count % len(self._frames)
        dropout = self._watch.dropout
        for joint, given in enumerate(commands):
            before, command = self._sent[joint], dropout.command(joint + 1, given)
            if command is None or (command == before and joint != again):
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
        """Quick stop to all drives; before it to those that went astray what takes their power.

        Raises
        ------
        BusError
            A frame did not go out; quick stop was sent all the same, by the handle of its own.
        """
        self._sent = [None] * len(self._frames)
        try:
            for at, command in enumerate(commands or ()):
                if at + 1 not in self._watch.switched_off:
                    continue
                off = replace(command, controlword=CONTROLWORD_DISABLE_VOLTAGE)
                # By this handle: what comes from the other one is not known for this program's own.
                for identifier, data in self._frames[at].pack_controlword(off):
                    self._send(identifier, data)
        finally:
            self._quick_stop()


def _moves_on(before: Setpoint | None, command: Setpoint) -> bool:
    """Whether nothing but the target is another: a move on its way."""
    return before is not None and (before.controlword, before.mode) == (
        command.controlword,
        command.mode,
    )

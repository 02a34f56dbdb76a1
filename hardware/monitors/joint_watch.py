"""What samples show that nobody says: readings that jump, joints that go astray, drives that leave. Knows no bus."""

from __future__ import annotations

from collections.abc import Sequence

from hardware.canopen.cyclic import Sample, Setpoints
from hardware.errors import HardwareError
from hardware.monitors.alarms import pressed, stopped_for
from hardware.monitors.continuity import Continuity, Jump
from hardware.monitors.dropout import Staying
from hardware.monitors.following import Astray, Following
from hardware.monitors.standstill import StandstillMonitor


class JointWatch:
    """Looks at every sample of the control loop, in its thread; what it found may be read from any.

    Parameters
    ----------
    allowed_counts
        By joint: how far a reading may seem to jump between two SYNCs by noise alone; empty: joints
        are not watched for it.
    astray
        The joint for which the arm was stopped before this began, and is stopped still.

    Attributes
    ----------
    jump, astray
        The first jump of a joint's reading that was no motion, and the first joint that was not where it
        was told to be, for which the arm was stopped; None if there was none.
    switched_off
        All joints that went astray: their drives have no power any more.
    staying
        Knows which drives did not stay as they were put, and what those are sent.
    """

    def __init__(
        self, allowed_counts: Sequence[float] = (), *, astray: Astray | None = None
    ) -> None:
        self.jump: Jump | None = None
        self.astray = astray
        self.switched_off: frozenset[int] = frozenset()
        self.staying = Staying()
        self._strays: tuple[Following, StandstillMonitor] = (Following(), StandstillMonitor())
        self._looks_for_jumps = bool(allowed_counts)
        self._continuity = Continuity(allowed_counts)

    def allow_away(self, windows_counts: Sequence[float]) -> None:
        """Watch for joints that go astray, while they are led and once they were stopped.

        `windows_counts`, by joint: how far it may be from its target, and from where it came to rest. Set
        before SYNCs go out.
        """
        self._strays = Following(windows_counts), StandstillMonitor(windows_counts)

    @property
    def stopped_for(self) -> str:
        """What the loop has latched STOP for by itself, in words; "" where it did not."""
        astray = self.astray
        return "" if astray is None else str(stopped_for(astray))

    def why_stopped(self) -> HardwareError:
        """Why STOP is latched: because it was pressed, or because a drive has gone astray."""
        astray = self.astray
        return pressed() if astray is None else stopped_for(astray)

    def look(
        self,
        sample: Sample,
        commands: Setpoints | None,
        *,
        answered_late: bool,
        stopped: bool = False,
    ) -> bool:
        """Take in a sample and the commands that were sent before it; whether a joint has just gone astray.

        `answered_late`: the sample may hold answers to earlier SYNCs; `stopped`: STOP was latched before it.
        """
        if self.jump is None and self._looks_for_jumps:
            if answered_late:
                self._continuity.interrupt()
            self.jump = self._continuity.see(sample)
        self.staying.see(sample, commands, stopped=stopped)
        before = self.switched_off
        for strays in self._strays:
            found = strays.see(sample, commands)
            if found is not None:
                self.astray = self.astray or found
                self.switched_off |= {found.joint}
        return self.switched_off != before

    def disturb(self) -> None:
        """Hear that a drive is given more than the next target of its way: its joint may well jerk."""
        self._continuity.disturb()

    def forget(self) -> None:
        """Forget what was found so far."""
        self.jump = self.astray = None
        self.staying.forget()
        self.switched_off = frozenset()

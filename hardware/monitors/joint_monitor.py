"""All monitors of the samples: count jumps, uncommanded motion, drive dropouts."""

from __future__ import annotations

from collections.abc import Sequence

from hardware.canopen.cyclic import Sample, Setpoints
from hardware.errors import HardwareError
from hardware.monitors.alarms import divergence_error, stop_latched_error
from hardware.monitors.continuity import ContinuityMonitor, CountJump
from hardware.monitors.dropout import DropoutMonitor
from hardware.monitors.following import Divergence, FollowingMonitor
from hardware.monitors.standstill import StandstillMonitor


class JointMonitor:
    """Checks every sample in the control loop's thread; its attributes may be read from any thread.

    Parameters
    ----------
    allowed_counts
        Each joint's threshold for count jumps; empty for no check.
    divergence
        The uncommanded motion for which STOP was latched in an earlier connection and still is.

    Attributes
    ----------
    jump, divergence
        The first count jump and the first uncommanded motion, for which the arm was stopped; None if none.
    switched_off
        Joints with uncommanded motion: their drives are switched off.
    dropout
        Monitor of drive dropouts.
    """

    def __init__(
        self, allowed_counts: Sequence[float] = (), *, divergence: Divergence | None = None
    ) -> None:
        self.jump: CountJump | None = None
        self.divergence = divergence
        self.switched_off: frozenset[int] = frozenset()
        self.dropout = DropoutMonitor()
        self._motion: tuple[FollowingMonitor, StandstillMonitor] = (
            FollowingMonitor(),
            StandstillMonitor(),
        )
        self._detects_jumps = bool(allowed_counts)
        self._continuity = ContinuityMonitor(allowed_counts)

    def set_following_windows(self, windows_counts: Sequence[float]) -> None:
        """Set each joint's limit from its target, and from rest once stopped; before SYNC starts."""
        self._motion = FollowingMonitor(windows_counts), StandstillMonitor(windows_counts)

    @property
    def stopped_for(self) -> str:
        """Why the control loop latched STOP by itself; empty if it did not."""
        return "" if self.divergence is None else str(divergence_error(self.divergence))

    def stop_cause(self) -> HardwareError:
        """Error for the latched STOP: uncommanded motion, or a press."""
        found = self.divergence
        return stop_latched_error() if found is None else divergence_error(found)

    def update(
        self,
        sample: Sample,
        commands: Setpoints | None,
        *,
        answered_late: bool,
        stopped: bool = False,
    ) -> bool:
        """Take in a sample and the commands sent before it; return whether a joint just diverged.

        `answered_late`: the sample may hold answers to earlier SYNCs; `stopped`: STOP was latched before it.
        """
        if self.jump is None and self._detects_jumps:
            if answered_late:
                self._continuity.restart_history()
            self.jump = self._continuity.update(sample)
        self.dropout.update(sample, commands, stopped=stopped)
        before = self.switched_off
        for monitor in self._motion:
            found = monitor.update(sample, commands)
            if found is not None:
                self.divergence = self.divergence or found
                self.switched_off |= {found.joint}
        return self.switched_off != before

    def expect_jerk(self) -> None:
        """Suspend jump detection: a drive gets more than the next target of its move."""
        self._continuity.expect_jerk()

    def reset(self) -> None:
        """Clear what was found so far."""
        self.jump = self.divergence = None
        self.dropout.reset()
        self.switched_off = frozenset()

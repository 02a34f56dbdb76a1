"""Messages and journal entries about host latency: times when this computer was too busy to read the bus.

Host latency is distinguished from an arm that does not answer, because the remedies differ.
"""

from __future__ import annotations

from hardware.arm import NO_LATENCY, ArmInterface, HostLatency
from operator_app.session.store.logbook import Logbook

MIN_INTERVAL_S = 30.0
"""Shortest time between two messages."""


def lateness_text(times: int, longest_s: float) -> str:
    """Return the message about `times` delays, the longest of which lasted `longest_s`."""
    how = f"was late by {longest_s:.1f} s" if times == 1 else f"was late {times} times"
    most = "" if times == 1 else f", by {longest_s:.1f} s at most"
    return (
        f"this computer {how}{most}: it was too busy, or sarcal was suspended (Ctrl+Z), and no new targets were sent. "
        "The session goes on, unless drives missed the heartbeat (8130h). End other programs on this computer, and do "
        "not suspend sarcal"
    )


class LatenessReporter:
    """Makes the messages about new delays of one connection."""

    def __init__(self) -> None:
        self._reported = NO_LATENCY
        self._reported_at_s = -MIN_INTERVAL_S

    def new_text(self, lateness: HostLatency, now_s: float) -> str:
        """Return a message about new delays; "" if there are none, or within `MIN_INTERVAL_S` of the last message."""
        new = lateness.times - self._reported.times
        if new == 0 or now_s - self._reported_at_s < MIN_INTERVAL_S:
            return ""
        self._reported, self._reported_at_s = lateness, now_s
        return lateness_text(new, lateness.last_s if new == 1 else lateness.longest_s)


class LatenessRecorder:
    """Records new delays of one connection in the journal; `recorded` is the host latency recorded so far."""

    def __init__(self, logbook: Logbook, arm: ArmInterface) -> None:
        self._logbook, self._arm = logbook, arm
        self.recorded = NO_LATENCY

    def record(self) -> None:
        """Record new delays, if any."""
        late = self._arm.snapshot().lateness
        new = late.times - self.recorded.times
        if new > 0:
            delays = {"last_s": late.last_s, "longest_s": late.longest_s}
            self._logbook.record("late", {"times": new, **delays})
        self.recorded = late

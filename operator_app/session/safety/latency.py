"""What is said, and kept, of a computer that was too busy to listen to its arm: each time once, and no flood.

It is told apart from the arm's silence, since the remedy is another one.
"""

from __future__ import annotations

from hardware.arm import NO_LATENCY, Arm, HostLatency
from operator_app.session.store.logbook import Logbook

AGAIN_S = 30.0
"""What happens again sooner is said with what comes after it."""


def late_words(times: int, longest_s: float) -> str:
    """Say that this computer was late so often, and by how much at most, and what follows from it."""
    how = f"was late by {longest_s:.1f} s" if times == 1 else f"was late {times} times"
    most = "" if times == 1 else f", by {longest_s:.1f} s at most"
    return (
        f"this computer {how}{most}: too busy to listen to the arm, which was told nothing new meanwhile. "
        "What came counted as old, and the session goes on, unless drives missed the heartbeat (8130h). "
        "End other programs on it"
    )


class LatenessNews:
    """Says how late this program was, of one connection, since it was said last."""

    def __init__(self) -> None:
        self._told = NO_LATENCY
        self._told_at_s = -AGAIN_S

    def since(self, lateness: HostLatency, now_s: float) -> str:
        """Return what is new, in words; "" if nothing is, or something was said a moment ago."""
        new = lateness.times - self._told.times
        if new == 0 or now_s - self._told_at_s < AGAIN_S:
            return ""
        self._told, self._told_at_s = lateness, now_s
        return late_words(new, lateness.last_s if new == 1 else lateness.longest_s)


class LatenessLog:
    """Keeps in the journal how late this program was, of one connection, since that was kept last."""

    def __init__(self, logbook: Logbook, arm: Arm) -> None:
        self._logbook, self._arm = logbook, arm
        self._kept = NO_LATENCY

    @property
    def kept(self) -> HostLatency:
        """What was kept of this connection."""
        return self._kept

    def begin(self) -> None:
        """Begin to count anew: there is a new connection."""
        self._kept = NO_LATENCY

    def record(self) -> None:
        """Keep what is new, if anything."""
        late = self._arm.snapshot().lateness
        new = late.times - self._kept.times
        if new > 0:
            found = {"last_s": late.last_s, "longest_s": late.longest_s}
            self._logbook.record("late", {"times": new, **found})
        self._kept = late

"""Messages about host latency: times when this computer was too busy to read the bus.

Host latency is distinguished from an arm that does not answer, because the remedies differ.
"""

from __future__ import annotations

from hardware.arm import NO_LATENCY, HostLatency

MIN_INTERVAL_S = 30.0
"""Shortest time between two messages."""


def lateness_text(late: HostLatency, times: int) -> str:
    """Return the message about the last `times` delays."""
    how = f"by {late.last_s:.1f} s"
    if times > 1:
        how = f"{times} times, the last time {how}"
    return (
        f"this computer was late {how}: it was too busy, or sarcal was suspended (Ctrl+Z), and no new targets were "
        "sent. The session goes on, unless drives missed the heartbeat (8130h). End other programs on this computer, "
        "and do not suspend sarcal"
    )


class LatenessReporter:
    """Makes the messages about new delays of one connection."""

    def __init__(self) -> None:
        self._reported = NO_LATENCY
        self._reported_at_s = -MIN_INTERVAL_S

    def new_text(self, lateness: HostLatency, now_s: float) -> str:
        """Return a message about new delays; "" if none are new, or the last message is newer than `MIN_INTERVAL_S`."""
        new = lateness.times - self._reported.times
        if new == 0 or now_s - self._reported_at_s < MIN_INTERVAL_S:
            return ""
        self._reported, self._reported_at_s = lateness, now_s
        return lateness_text(lateness, new)

"""Measures the host's own latency, so that it is not counted as silence of the arm.

On a busy computer the receiving thread may not run for a second, and what the arm sent waits in a queue.
Silences are measured without that time, and a frame's age counts from its arrival, not from its reading.
"""

from __future__ import annotations

from collections.abc import Callable

from hardware.arm import HostLatency

MAX_POLL_GAP_S = 0.1
"""Time between two polls of the bus that still counts as listening: the loop's longest wait plus scheduling."""
REPORTED_S = 0.3
"""Latency reported to the operator; drives trip after 0.5 s without our heartbeat."""


class LatencyMonitor:
    """Accumulates host latency; the receiving thread calls it for every poll of the bus.

    A frame's waiting time is the difference of two readings of the clock that stamps frames: on arrival and
    now. That clock may be set meanwhile, so a frame is never older than the last moment the queue was empty.
    Without a usable stamp a frame counts as arrived when it is read.

    Parameters
    ----------
    clock
        Monotonic time, s.
    stamps
        Clock of the frame stamps; None if it is not one of this computer's.
    arm_waits
        Whether the arm's time stands still while the host is busy (`Pace.FAST_FORWARD`): no latency then.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        stamps: Callable[[], float] | None = None,
        *,
        arm_waits: bool = False,
    ) -> None:
        self._clock, self._stamps, self._arm_waits = clock, stamps, arm_waits
        self._lateness = HostLatency()
        self.begin()

    def begin(self) -> None:
        """Start counting."""
        now = self._clock()
        self._last = (now, 0.0)  # replaced as a whole: other threads read a consistent pair
        self._queue_empty_at_s = now
        self._late_now = False

    def frame_read(self, stamp_s: float = 0.0) -> float:
        """Record that a frame was read now; return how long it had waited, s. A stamp of 0 is none."""
        now = self._clock()
        waited_s = 0.0
        if self._stamps is not None and stamp_s:
            waited_s = max(0.0, min(self._stamps() - stamp_s, now - self._queue_empty_at_s))
        self._note(now, waited_s)
        return waited_s

    def queue_empty(self, polled_at_s: float) -> None:
        """Record that a poll begun at `polled_at_s` found no frame within its wait."""
        self._note(self._clock(), 0.0)
        self._queue_empty_at_s = polled_at_s
        self._late_now = False

    @property
    def lateness(self) -> HostLatency:
        """Latencies above `REPORTED_S` so far."""
        return self._lateness

    @property
    def late_s(self) -> float:
        """Total time without polling, s."""
        return self._late_at(self._clock())

    @property
    def listened_s(self) -> float:
        """Clock less the time without polling: the time base of silences, s."""
        now = self._clock()
        return now - self._late_at(now)

    def _note(self, now: float, waited_s: float) -> None:
        by_s = max(now - self._last[0], waited_s)
        self._last = (now, self._late_at(now))
        if by_s >= REPORTED_S and not self._arm_waits:
            self._lateness = self._lateness.with_event(by_s, new=not self._late_now)
            self._late_now = True

    def _late_at(self, now: float) -> float:
        last, late = self._last
        return late + max(0.0, now - last - MAX_POLL_GAP_S)

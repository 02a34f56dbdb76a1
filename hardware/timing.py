"""Timing of the cyclic traffic: pace, time-outs, host latency, real-time scheduling of the process.

`REAL_TIME`: a SYNC every control period. `FAST_FORWARD`: SYNCs only while a motion step runs, each as soon as all
joints have answered the previous SYNC; a run on a seeded virtual arm is then reproducible.
"""

import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from hardware.arm import HostLatency
from hardware.canopen.objects import CONTROL_PERIOD_S


class Pace(Enum):
    """When a SYNC is sent: every control period or, in fast forward, once all joints have answered the previous one."""

    REAL_TIME = "real time"
    FAST_FORWARD = "fast forward"


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Periods and time-outs of a connection and its control loop."""

    heartbeat_timeout_s: float = 1.0
    listen_s: float = 0.35
    """Time to listen for another operator before anything is sent: more than three of its heartbeat periods."""
    boot_timeout_s: float = 3.0
    """Time-out for a node to boot, and to start."""
    operator_timeout_s: float = 1.0
    """Time without a heartbeat after which another operator counts as gone; longer if a node has a longer time-out."""
    sdo_timeout_s: float = 1.0
    upload_retry_s: float = 0.5
    """Pause between attempts to upload; a lapsed token is granted again after the next heartbeat (100 ms)."""
    answer_timeouts_s: Mapping[Pace, float] = field(
        default_factory=lambda: {Pace.REAL_TIME: 0.03, Pace.FAST_FORWARD: 0.5}
    )
    """Time-out of a joint's answer to SYNC, by pace; longer in fast forward, where waiting takes no simulated time."""
    min_misses: int = 3
    lost_after_s: float = 1.0
    """A joint is lost once it has missed `min_misses` consecutive SYNCs and has been silent for this time, s. Until
    then a move waits for its answers."""
    idle_poll_s: float = 0.002
    """First wait for a task when the loop is idle; later waits are longer."""
    speed: float = 1.0
    """Factor by which a simulated arm runs faster than real time; 1 for a real arm."""

    @property
    def tick_s(self) -> float:
        """Wall-clock time between SYNCs, s."""
        return CONTROL_PERIOD_S / self.speed

    def misses(self, pace: Pace) -> int:
        """Return the number of consecutive SYNCs without an answer after which a joint counts as lost."""
        return max(self.min_misses, round(self.lost_after_s / self.answer_timeouts_s[pace]))


PRIORITY: Final = 1
"""The lowest real-time priority: above all ordinary programs, below other real-time programs."""

LOOP_PRIORITY: Final = 2
"""Priority of the control loops' threads, which compute little: threads of equal priority could delay them by 0.1 s.
The other threads are real-time too: a thread that holds the interpreter lock, but gets no processor, blocks a loop."""


@contextmanager
def real_time_priority() -> Iterator[None]:
    """Context in which this thread, and threads it starts, have real-time scheduling, if allowed.

    Niceness is not enough: Linux shares the processor between terminal sessions (autogroup), so a low-priority (niced)
    program in another session still gets as much time as the program that moves the arm. Users other than root need an
    rtprio limit (``ulimit -r``, limits.conf). Real-time threads get at most 95 % of a processor.
    """
    before, with_ = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):  # not allowed
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, before, with_)


def raise_loop_priority() -> None:
    """Give this thread priority over the program's other threads, if this thread has real-time scheduling."""
    if os.sched_getscheduler(0) == os.SCHED_RR:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(LOOP_PRIORITY))


def normal_priority() -> None:
    """Give this thread, and threads that it starts, ordinary scheduling."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


MAX_POLL_GAP_S = 0.1
"""Longest time between two polls that does not count as host latency: the loop's longest wait, plus scheduling."""
REPORTED_S = 0.3
"""Smallest latency that is reported; drives trip after 0.5 s without the operator's heartbeat."""


class LatencyMonitor:
    """Accumulates host latency; the receiving thread reports every poll of the bus.

    On a busy computer the receiving thread may be suspended for a second while frames wait in a queue. That time does
    not count as silence of the arm. A frame's waiting time is the time from its stamp until it is read, or 0 without a
    usable stamp. Stamps are wrong once the computer's clock has been set. So the waiting time is limited to the time
    since the queue was last empty.

    `clock` returns monotonic time, s. `stamps` returns the time, s, of the clock that stamps frames; None if that clock
    is not this computer's. `arm_waits`: whether the simulated arm waits for this host, so that no latency is reported.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        stamps: Callable[[], float] | None = None,
        *,
        arm_waits: bool = False,
    ) -> None:
        self._clock, self._stamps, self._arm_waits = clock, stamps, arm_waits
        self.lateness = HostLatency()
        """Latencies above `REPORTED_S` so far."""
        self.begin()

    def begin(self) -> None:
        """Start measuring, or start again, from an accumulated latency of 0."""
        now = self._clock()
        self._last = (now, 0.0)  # replaced as a whole: other threads read a consistent pair
        self._queue_empty_at_s = now
        self._late_now = False

    def end(self) -> None:
        """End measuring: nobody reads the bus any more, and silence from now on is not the host's."""
        self._last = (math.inf, self.late_s)

    def frame_read(self, stamp_s: float = 0.0) -> float:
        """Record that a frame was read now; return how long it waited to be read, s. A stamp of 0 means no stamp."""
        now = self._clock()
        waited_s = 0.0
        if self._stamps is not None and stamp_s:
            waited_s = max(0.0, min(self._stamps() - stamp_s, now - self._queue_empty_at_s))
        self._note(now, waited_s)
        return waited_s

    def queue_empty(self, polled_at_s: float) -> None:
        """Record a poll that timed out without a frame; `polled_at_s`: start of the poll."""
        self._note(self._clock(), 0.0)
        self._queue_empty_at_s = polled_at_s
        self._late_now = False

    @property
    def late_s(self) -> float:
        """Accumulated host latency, s: the sum, over all gaps between polls, of the time beyond `MAX_POLL_GAP_S`."""
        return self._late_at(self._clock())

    @property
    def listened_s(self) -> float:
        """Time base for measuring silence, s: the time of `clock` minus `late_s`, so that only listening counts."""
        now = self._clock()
        return now - self._late_at(now)

    def _note(self, now: float, waited_s: float) -> None:
        by_s = max(now - self._last[0], waited_s)
        self._last = (now, self._late_at(now))
        if by_s >= REPORTED_S and not self._arm_waits:
            self.lateness = self.lateness.with_event(by_s, new=not self._late_now)
            self._late_now = True

    def _late_at(self, now: float) -> float:
        last, late = self._last
        return late + max(0.0, now - last - MAX_POLL_GAP_S)

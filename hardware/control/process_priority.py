"""Real-time scheduling of the process and of its control loop.

Niceness is not enough: Linux shares the processor between terminal sessions (autogroup), so a nice program in
another session still gets as much of it as the program that moves the arm.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

PRIORITY: Final = 1
"""The lowest real-time priority: above all ordinary programs, below other real-time ones."""

LOOP_PRIORITY: Final = 2
"""Priority of the loops, which compute little; threads of equal priority wait up to 0.1 s for each other. The rest
of the program is real-time too, since the thread that holds the interpreter blocks the loop."""


@contextmanager
def real_time_priority() -> Iterator[None]:
    """Run this thread and the threads it starts in real time; as before if not allowed.

    Allowed for root, and by ``ulimit -r`` (rtprio in limits.conf). The kernel limits real-time threads to 95 % of
    a processor.
    """
    if sys.platform != "linux":
        yield
        return
    before, with_ = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
    except OSError:
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, before, with_)


def raise_loop_priority() -> None:
    """Run this thread before all others of its program, if that runs in real time."""
    if sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_RR:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(LOOP_PRIORITY))


def normal_priority() -> None:
    """Run this process with ordinary scheduling."""
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

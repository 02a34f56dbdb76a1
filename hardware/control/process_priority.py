"""Asks the system to run whoever keeps the time of an arm before other programs. Knows no bus and no arm.

Niceness would not do: Linux weighs whole terminal sessions against each other (autogroup), and a polite
neighbour in another one has as much of the processor as the program that moves an arm.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

PRIORITY: Final = 1
"""The lowest of the real-time ones: before all ordinary programs, behind whatever else is in real time."""

LOOP_PRIORITY: Final = 2
"""Of threads with a time to keep, who hardly compute: among equals, each may wait a tenth of a second for
every other, and planning and printing must not make the loop wait. The rest of its program runs in real time
too, since whoever holds the interpreter holds up the loop."""


@contextmanager
def real_time_priority() -> Iterator[None]:
    """Run this thread, and the threads it starts, before ordinary programs; in turn where not allowed.

    Allowed to root, and to whom ``ulimit -r`` (rtprio in limits.conf) says so. A thread that never rests
    is held back by the kernel all the same (95 % of a processor).
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
    """Run this thread before all others of its program, if that is `real_time_priority`."""
    if sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_RR:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(LOOP_PRIORITY))


def normal_priority() -> None:
    """Run this process as any other, whoever started it."""
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

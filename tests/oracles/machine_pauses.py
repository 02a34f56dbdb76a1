"""When the machine itself stood still: a clock on every processor that nothing on it can delay.

A process for each processor, at a priority above all that is measured, sleeps 5 ms again and again. What it
wakes late by, a host took from the virtual machine (or its kernel from everybody): no program in it could
have run there. Knows nothing of what is measured.
"""

import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from typing import Any

SPAWN = get_context("spawn")
PRIORITY, NAP_S, LATE_S = 90, 0.005, 0.005


@dataclass(slots=True, kw_only=True)
class Pauses:
    """What `machine_pauses` yields.

    `of`: by processor the pauses (from, to), s of the wall clock, once it is over. `known`: whether the
    priority was to be had; without it nothing can be said.
    """

    of: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    known: bool = True

    def longest_s(self, begin: float = -math.inf, end: float = math.inf) -> float:
        """Longest pause (s) of any processor that touches the time between two moments."""
        return max(
            (b - a for one in self.of.values() for a, b in one if b >= begin and a <= end),
            default=0.0,
        )

    def within_s(self, begin: float, end: float) -> float:
        """Seconds that one processor, the one that lost most, was away between two moments."""
        return max(
            (
                sum(max(0.0, min(b, end) - max(a, begin)) for a, b in one)
                for one in self.of.values()
            ),
            default=0.0,
        )


def _clock(processor: int, ready: Event, done: Event, pipe: Any) -> None:
    os.sched_setaffinity(0, {processor})
    known = True
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        known = False
    found: list[tuple[float, float]] = []
    ready.set()
    due = time.monotonic() + NAP_S
    while not done.is_set():
        time.sleep(max(0.0, due - time.monotonic()))
        late = time.monotonic() - due
        if late > LATE_S:
            now = time.time()
            found.append((now - late, now))
        due = time.monotonic() + NAP_S
    pipe.send((processor, known, found))


@contextmanager
def machine_pauses() -> Iterator[Pauses]:
    """Note when processors stood still, for as long as it is open."""
    done, seen, running = SPAWN.Event(), Pauses(), []
    for processor in sorted(os.sched_getaffinity(0)):
        ready, (near, far) = SPAWN.Event(), SPAWN.Pipe(duplex=False)
        process = SPAWN.Process(target=_clock, args=(processor, ready, done, far), daemon=True)
        process.start()
        running.append((process, ready, near))
    try:
        if not all(ready.wait(60) for _, ready, _ in running):
            raise TimeoutError("the clocks beside it did not begin")
        yield seen
    finally:
        done.set()
        for process, _, near in running:
            if near.poll(30):
                processor, known, found = near.recv()
                seen.of[processor] = found
                seen.known &= known
            process.join(30)

"""Pauses of the machine: times in which a host did not run a virtual machine's processor.

On each processor, a process of the highest priority sleeps 5 ms repeatedly. No program could have run while it woke
up late.
"""

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
class MachinePauses:
    """Pauses (from, to) by processor, s of the wall clock; not `known` if the priority was not granted."""

    of: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    known: bool = True

    def longest_s(self, begin: float, end: float) -> float:
        """Longest pause (s) of any processor that overlaps an interval."""
        pauses = (pause for processor in self.of.values() for pause in processor)
        return max((b - a for a, b in pauses if b >= begin and a <= end), default=0.0)

    def within_s(self, begin: float, end: float) -> float:
        """Total pause (s) within an interval, of the processor with the largest."""

        def total_s(pauses: list[tuple[float, float]]) -> float:
            return sum(max(0.0, min(b, end) - max(a, begin)) for a, b in pauses)

        return max(map(total_s, self.of.values()), default=0.0)


def _clock(processor: int, ready: Event, done: Event, pipe: Any) -> None:
    os.sched_setaffinity(0, {processor})
    known = True
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        known = False
    pauses: list[tuple[float, float]] = []
    ready.set()
    due = time.monotonic() + NAP_S
    while not done.is_set():
        time.sleep(max(0.0, due - time.monotonic()))
        late = time.monotonic() - due
        if late > LATE_S:
            now = time.time()
            pauses.append((now - late, now))
        due = time.monotonic() + NAP_S
    pipe.send((processor, known, pauses))


@contextmanager
def machine_pauses() -> Iterator[MachinePauses]:
    """Record the pauses of every processor."""
    done, pauses, running = SPAWN.Event(), MachinePauses(), []
    for processor in sorted(os.sched_getaffinity(0)):
        ready, (receiver, sender) = SPAWN.Event(), SPAWN.Pipe(duplex=False)
        process = SPAWN.Process(target=_clock, args=(processor, ready, done, sender), daemon=True)
        process.start()
        running.append((process, ready, receiver))
    try:
        if not all(ready.wait(60) for _, ready, _ in running):
            raise TimeoutError("a clock process did not start")
        yield pauses
    finally:
        done.set()
        for process, _, receiver in running:
            if receiver.poll(30):
                processor, known, intervals = receiver.recv()
                pauses.of[processor] = intervals
                pauses.known &= known
            process.join(30)

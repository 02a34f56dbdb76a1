"""Load on a loopback bus by other nodes' frames, kernel time stamps of every SYNC, and pauses of the machine.

A kernel filter passes only SYNCs to their recorder, which therefore never lags. Pauses are times in which a host did
not run a virtual machine's processor: on each one, a process of the highest priority sleeps 5 ms repeatedly. No program
could have run while it woke up late.
"""

import os
import random
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import can

from hardware.buses.loopback import MULTICAST_PORT, LoopbackBus, channel_group

SYNC = 0x080
SPAWN = get_context("spawn")
PRIORITY, NAP_S, LATE_S = 90, 0.005, 0.005


def foreign_frames(count: int) -> list[can.Message]:
    """Frames of other nodes: PDOs, heartbeats, 29-bit frames."""
    rng = random.Random(0)  # noqa: S311 - to be repeated, not to be secret
    frames = []
    for _ in range(count):
        extended = False
        match rng.randrange(10):
            case 0:
                identifier, data = 0x700 + rng.randrange(20, 120), b"\x05"
            case 1:
                identifier, data = 0x180 + rng.randrange(20, 120), rng.randbytes(8)
            case 2:
                identifier, data, extended = rng.randrange(1 << 29), rng.randbytes(8), True
            case _:
                identifier, data = rng.randrange(0x288, 0x57F), rng.randbytes(rng.randrange(9))
        frames.append(can.Message(arbitration_id=identifier, data=data, is_extended_id=extended))
    return frames


def send_foreign_frames(channel: str, rate: float, done: Event, sent: Any) -> None:
    """Send `rate` frames a second on average until `done`; `sent` counts them."""
    frames, start_s, count = foreign_frames(4096), time.monotonic(), 0
    with LoopbackBus(channel, can_filters=[{"can_id": 0x7FF, "can_mask": 0x7FF}]) as bus:
        while not done.is_set():
            due = int((time.monotonic() - start_s) * rate)
            # A backlog is sent at the rate of a 1 Mbit/s bus of short frames at most.
            for _ in range(min(due - count, 64)):
                bus.send(frames[count % len(frames)], timeout=1.0)
                count += 1
            sent.value = count
            time.sleep(0.001)


def compute(done: Event) -> None:
    while not done.is_set():
        sum(range(100_000))


def record_syncs(channel: str, done: Event, pipe: Any) -> None:
    """Send the times of all SYNCs until `done` through the pipe, after True when it is ready."""
    sync_filter = [{"can_id": SYNC, "can_mask": 0x7FF, "extended": False}]
    times_s: list[float] = []
    with LoopbackBus(channel, can_filters=sync_filter) as bus:
        pipe.send(True)
        while (message := bus.recv(0.05)) is not None or not done.is_set():
            if message is not None:
                times_s.append(message.timestamp)
    pipe.send(times_s)


def record_pauses(processor: int, done: Event, pipe: Any) -> None:
    """Send the pauses (from, to) of a processor through the pipe, after whether its priority was granted."""
    os.sched_setaffinity(0, {processor})
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        pipe.send(False)
    else:
        pipe.send(True)
    pauses: list[tuple[float, float]] = []
    due = time.monotonic() + NAP_S
    while not done.is_set():
        time.sleep(max(0.0, due - time.monotonic()))
        late = time.monotonic() - due
        if late > LATE_S:
            now = time.time()
            pauses.append((now - late, now))
        due = time.monotonic() + NAP_S
    pipe.send(pauses)


@dataclass(slots=True, kw_only=True)
class BusLoad:
    """Number of frames `sent` so far (a shared value); at the end, times of SYNCs and pauses of each processor.

    Times are seconds of the wall clock. Without `known` pauses there are none.
    """

    sent: Any
    syncs_s: list[float] = field(default_factory=list)
    pauses: list[list[tuple[float, float]]] = field(default_factory=list)
    known: bool = True

    def longest_pause_s(self, begin: float, end: float) -> float:
        """Longest pause of any processor that overlaps an interval."""
        pauses = (pause for processor in self.pauses for pause in processor)
        return max((b - a for a, b in pauses if b >= begin and a <= end), default=0.0)

    def paused_s(self, begin: float, end: float) -> float:
        """Total pause within an interval, of the processor with the largest."""
        totals = (
            sum(max(0.0, min(b, end) - max(a, begin)) for a, b in processor)
            for processor in self.pauses
        )
        return max(totals, default=0.0)


def backlog_bytes(channel: str) -> int:
    """Longest receive queue of this channel's sockets (/proc/net/udp)."""
    group = int.from_bytes(socket.inet_aton(channel_group(channel)), "little")
    address = f"{group:08X}:{MULTICAST_PORT:04X}"
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return max((int(row[4].split(":")[1], 16) for row in rows if row[1] == address), default=0)


@contextmanager
def loaded_bus(channel: str, *, rate: float, busy: int = 0) -> Iterator[BusLoad]:
    """Send `rate` foreign frames a second on a channel, beside `busy` processes that only compute."""
    done, watched = SPAWN.Event(), SPAWN.Event()
    load = BusLoad(sent=SPAWN.Value("q", 0, lock=False))
    jobs: list[tuple[Any, tuple[Any, ...]]] = [
        (send_foreign_frames, (channel, rate, done, load.sent)),
        *[(compute, (done,))] * busy,
    ]
    results = []
    recorders = [(record_syncs, channel)]
    recorders += [(record_pauses, processor) for processor in sorted(os.sched_getaffinity(0))]
    for record, of in recorders:
        receiver, sender = SPAWN.Pipe(duplex=False)
        results.append(receiver)
        jobs.append((record, (of, watched, sender)))
    processes = [SPAWN.Process(target=job, args=args, daemon=True) for job, args in jobs]
    for process in processes:
        process.start()
    try:
        if not all(receiver.poll(300) for receiver in results):
            raise TimeoutError("a recorder did not start")
        load.known = False not in [receiver.recv() for receiver in results]
        yield load
    finally:
        watched.set()
        if all(receiver.poll(60) for receiver in results):
            load.syncs_s, *pauses = (receiver.recv() for receiver in results)
            load.pauses = pauses if load.known else []
        done.set()
        for process in processes:
            process.join(30)

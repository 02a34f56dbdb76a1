"""Load on a loopback bus by other nodes' frames, and kernel time stamps of every SYNC.

A kernel filter passes only the arm's frames to the recorder, which therefore never lags.
"""

import random
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can

from hardware.buses.loopback import MULTICAST_PORT, LoopbackBus, channel_group

SYNC, ANSWERS = 0x080, range(0x181, 0x188)
SPAWN = get_context("spawn")


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
    with LoopbackBus(channel, send_only=True) as bus:
        while not done.is_set():
            due = int((time.monotonic() - start_s) * rate)
            # A backlog is sent at the rate of a 1 Mbit/s bus of short frames at most.
            for _ in range(min(due - count, 64)):
                bus.send(frames[count % len(frames)], timeout=1.0)
                count += 1
            sent.value = count
            time.sleep(0.001)


@dataclass(frozen=True, slots=True, kw_only=True)
class SyncRecord:
    """SYNCs of a session: times `at_s`, and joints that answered before the next."""

    at_s: tuple[float, ...]
    answers: tuple[int, ...]

    def gaps_s(self) -> list[float]:
        return [b - a for a, b in zip(self.at_s, self.at_s[1:], strict=False)]


def record_syncs(channel: str, ready: Event, done: Event, pipe: Any) -> None:
    """Record SYNCs and answers until `done`; send a `SyncRecord` through the pipe."""
    arm = [{"can_id": i, "can_mask": 0x7FF, "extended": False} for i in (SYNC, *ANSWERS)]
    at_s: list[float] = []
    answers: list[int] = []
    with LoopbackBus(channel, can_filters=arm) as bus:
        ready.set()
        while (message := bus.recv(0.05)) is not None or not done.is_set():
            if message is None:
                continue
            if message.arbitration_id == SYNC:
                at_s.append(message.timestamp)
                answers.append(0)
            elif answers:
                answers[-1] += 1
    pipe.send(SyncRecord(at_s=tuple(at_s), answers=tuple(answers)))


def backlog_bytes(channel: str) -> int:
    """Longest receive queue of this channel's sockets (/proc/net/udp)."""
    group = int.from_bytes(socket.inet_aton(channel_group(channel)), "little")
    address = f"{group:08X}:{MULTICAST_PORT:04X}"
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return max((int(row[4].split(":")[1], 16) for row in rows if row[1] == address), default=0)


def compute(done: Event) -> None:
    while not done.is_set():
        sum(range(100_000))


@contextmanager
def loaded_bus(channel: str, *, rate: float, busy: int = 0) -> Iterator[SimpleNamespace]:
    """Send `rate` foreign frames a second on a channel, beside `busy` processes that only compute.

    Yields the number `sent` so far, a shared value; its `rhythm` is the `SyncRecord` at the end.
    """
    done, watch_done, ready = SPAWN.Event(), SPAWN.Event(), SPAWN.Event()
    sent = SPAWN.Value("q", 0, lock=False)
    receiver, sender = SPAWN.Pipe(duplex=False)
    jobs = [
        (record_syncs, (channel, ready, watch_done, sender)),
        (send_foreign_frames, (channel, rate, done, sent)),
        *[(compute, (done,))] * busy,
    ]
    processes = [SPAWN.Process(target=job, args=args, daemon=True) for job, args in jobs]
    load = SimpleNamespace(sent=sent, rhythm=None)
    for process in processes:
        process.start()
    try:
        if not ready.wait(300):
            raise TimeoutError("the recorder of the bus did not start")
        yield load
    finally:
        watch_done.set()
        if receiver.poll(60):
            load.rhythm = receiver.recv()
        done.set()
        for process in processes:
            process.join(30)

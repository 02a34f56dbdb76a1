"""Load on a loopback bus by other nodes' frames, and kernel time stamps of every SYNC.

Datagrams are as documented in `hardware.buses.loopback`. A kernel filter passes only the arm's frames to the
watcher, which therefore never lags; stamps are taken when a frame is sent.
"""

import contextlib
import ctypes
import hashlib
import random
import select
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

PORT = 43_117
HEADER = struct.Struct("!4s8sBBI")
EXTENDED = 1
SO_ATTACH_FILTER, SO_TIMESTAMPNS, IP_MULTICAST_ALL = 26, 35, 49
SYNC, FIRST_ANSWER, LAST_ANSWER = 0x080, 0x181, 0x187
SPAWN = get_context("spawn")


def tag_and_group(channel: str) -> tuple[bytes, str]:
    tag = hashlib.sha256(channel.encode()).digest()[:8]
    return tag, f"239.255.{tag[0]}.{tag[1]}"


def foreign_datagrams(tag: bytes, count: int) -> list[bytes]:
    """Datagrams of other nodes: PDOs, heartbeats, 29-bit frames."""
    rng = random.Random(0)  # noqa: S311 - to be repeated, not to be secret
    datagrams = []
    for _ in range(count):
        flags = 0
        match rng.randrange(10):
            case 0:
                identifier, data = 0x700 + rng.randrange(20, 120), b"\x05"
            case 1:
                identifier, data = 0x180 + rng.randrange(20, 120), rng.randbytes(8)
            case 2:
                identifier, data, flags = rng.randrange(1 << 29), rng.randbytes(8), EXTENDED
            case _:
                identifier, data = rng.randrange(0x288, 0x57F), rng.randbytes(rng.randrange(9))
        datagrams.append(HEADER.pack(b"CANo", tag, flags, len(data), identifier) + data)
    return datagrams


def send_foreign_frames(channel: str, rate: float, done: Event, sent: Any) -> None:
    """Send `rate` frames a second on average until `done`; `sent` counts them."""
    tag, group = tag_and_group(channel)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        sender.bind(("127.0.0.1", 0))
        frames, start_s, count = foreign_datagrams(tag, 4096), time.monotonic(), 0
        while not done.is_set():
            due = int((time.monotonic() - start_s) * rate)
            # A backlog is sent at the rate of a 1 Mbit/s bus of short frames at most.
            for _ in range(min(due - count, 64)):
                sender.sendto(frames[count % len(frames)], (group, PORT))
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


def _arm_frames_filter() -> bytes:
    """Classic BPF that passes the arm's identifiers, 22 bytes after the start of the UDP header."""
    load, equal, at_least, more, return_bytes = 0x20, 0x15, 0x35, 0x25, 0x06
    program = [
        (load, 0, 0, 8 + 14),
        (equal, 3, 0, SYNC),
        (at_least, 0, 1, FIRST_ANSWER),
        (more, 0, 1, LAST_ANSWER),
        (return_bytes, 0, 0, 0),
        (return_bytes, 0, 0, 0xFFFF),
    ]
    return b"".join(struct.pack("HBBI", *instruction) for instruction in program)


def record_syncs(channel: str, ready: Event, done: Event, pipe: Any) -> None:
    """Record SYNCs and answers until `done`; send a `SyncRecord` through the pipe."""
    tag, group = tag_and_group(channel)
    program = _arm_frames_filter()
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    at_s: list[float] = []
    answers: list[int] = []
    with listener:
        listener.setblocking(False)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        listener.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        listener.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)
        filter_program = ctypes.create_string_buffer(program, len(program))
        listener.setsockopt(
            socket.SOL_SOCKET,
            SO_ATTACH_FILTER,
            struct.pack("HxxxxxxP", len(program) // 8, ctypes.addressof(filter_program)),
        )
        listener.bind((group, PORT))
        listener.setsockopt(
            socket.IPPROTO_IP,
            socket.IP_ADD_MEMBERSHIP,
            socket.inet_aton(group) + socket.inet_aton("127.0.0.1"),
        )
        ready.set()
        while True:
            if not select.select([listener], [], [], 0.05)[0]:
                if done.is_set():
                    break
                continue
            with contextlib.suppress(BlockingIOError):
                datagram, ancillary, _, _ = listener.recvmsg(256, 128)
                magic, frame_tag, flags, _, identifier = HEADER.unpack_from(datagram)
                if (magic, frame_tag, flags) != (b"CANo", tag, 0):
                    continue
                stamp = 0.0
                for _, kind, value in ancillary:
                    if kind == SO_TIMESTAMPNS:
                        seconds, nano = struct.unpack_from("@qq", value)
                        stamp = seconds + nano * 1e-9
                if identifier == SYNC:
                    at_s.append(stamp)
                    answers.append(0)
                elif answers:
                    answers[-1] += 1
    pipe.send(SyncRecord(at_s=tuple(at_s), answers=tuple(answers)))


def backlog_bytes(channel: str) -> int:
    """Longest receive queue of this channel's sockets (/proc/net/udp)."""
    _, group = tag_and_group(channel)
    address = f"{int.from_bytes(socket.inet_aton(group), 'little'):08X}:{PORT:04X}"
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return max((int(row[4].split(":")[1], 16) for row in rows if row[1] == address), default=0)


def compute(done: Event) -> None:
    x = 1
    while not done.is_set():
        for _ in range(100_000):
            x = x * 1103515245 + 12345 & 0xFFFFFFFF


class BusLoad:
    """Frames sent by other nodes so far; the rhythm after the end of `loaded_bus`."""

    def __init__(self, sent: Any) -> None:
        self._sent = sent
        self.rhythm: SyncRecord | None = None

    @property
    def sent(self) -> int:
        return int(self._sent.value)


@contextmanager
def loaded_bus(channel: str, *, rate: float, busy: int = 0) -> Iterator[BusLoad]:
    """Send `rate` foreign frames a second on a channel, beside `busy` processes that only compute."""
    done, watch_done, ready = SPAWN.Event(), SPAWN.Event(), SPAWN.Event()
    sent = SPAWN.Value("q", 0, lock=False)
    receiver, sender = SPAWN.Pipe(duplex=False)
    recorder = SPAWN.Process(
        target=record_syncs, args=(channel, ready, watch_done, sender), daemon=True
    )
    others = [SPAWN.Process(target=compute, args=(done,), daemon=True) for _ in range(busy)]
    if rate:
        others.append(
            SPAWN.Process(target=send_foreign_frames, args=(channel, rate, done, sent), daemon=True)
        )
    load = BusLoad(sent)
    for process in (recorder, *others):
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
        for process in (recorder, *others):
            process.join(30)

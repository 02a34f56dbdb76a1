"""Fake CAN bus with eight CANopen nodes behind it, without a thread.

Written from the design's tables in plain numbers, so that it shares no code with the product; the `canopen` package
serves SDO. Every sent frame is answered at once, into the queue that `recv` reads. Drives are ideal: a joint in
position mode reaches its target one period later.
"""

import hashlib
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from types import SimpleNamespace
from typing import Any

import can
from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from tests.oracles.foreign_arm import Axis, servo

JOINTS = 7
COUNTS_PER_REV = 400_000
SUPERVISOR = 16
MAPS = {
    0x1600: (3, 0x60400010, 0x607A0020, 0x60600008),
    0x1A00: (3, 0x60410010, 0x60640020, 0x60770010),
}


@dataclass
class FakeDrive(Axis):
    counts: int = 1000
    torque: int = 0
    follows_mode: bool = True
    ignores: tuple[int, ...] = ()
    """Controlwords without effect while the drive is enabled."""
    noise: Callable[[int], int] = lambda _sync: 0
    received: list[tuple[int, int, int]] = field(default_factory=list)

    def rpdo(self, data: bytes) -> None:
        word, target, mode = struct.unpack("<Hib", data)
        self.received.append((word, target, mode))
        if self.status == 0x27 and word in self.ignores:
            return
        self.obey(word, target)
        if self.follows_mode and mode in (8, 10):
            self.mode = mode


@dataclass
class FrameLoss:
    """Loses the first `times` frames with this beginning, after `skip` that arrive, and acts at each."""

    identifier: int
    begin: bytes
    times: int = 1
    skip: int = 0
    act: Callable[[int], None] = lambda _lost: None
    lost: int = 0

    def __call__(self, identifier: int, data: bytes) -> bool:
        matches = identifier == self.identifier and data.startswith(self.begin)
        if not matches or self.lost == self.times:
            return False
        if self.skip:
            self.skip -= 1
            return False
        self.lost += 1
        self.act(self.lost)
        return True


class FakeServer(SdoServer):
    """SDO server of the `canopen` package for the objects of one node of `bus`."""

    def __init__(self, bus: "FakeArmBus", number: int) -> None:
        node = SimpleNamespace(object_dictionary={}, get_data=self.get_data, set_data=self.set_data)
        super().__init__(0x600 + number, 0x580 + number, node)
        self._bus, self._number = bus, number
        self.network = SimpleNamespace(send_message=lambda _, data: bus.answer(number, bytes(data)))

    def get_data(self, index: int, subindex: int, **_: Any) -> bytes:
        value = self._bus.object_of(self._number, index, subindex)
        if isinstance(value, int):
            raise SdoAbortedError(value)
        return value

    def set_data(self, index: int, subindex: int, data: bytes, **_: Any) -> None:
        self._bus.store(index, bytes(data))

    def request_aborted(self, data: bytes) -> None:
        self._toggle = None  # further segments of that transfer are refused


class FakeArmBus(can.BusABC):
    """The bus; `stop_handle` returns the second handle, which STOP uses."""

    def __init__(self) -> None:
        self.drives = {j: FakeDrive(counts=1000 * j) for j in range(1, JOINTS)}
        self.drives[JOINTS] = FakeDrive(counts=100)
        self._servers = {node: FakeServer(self, node) for node in (*self.drives, SUPERVISOR)}
        self.syncs = 0
        self.sent: list[tuple[int, bytes]] = []
        self.without_heartbeat: set[int] = set()
        self.never_starts: set[int] = set()
        self.duplicates_response: Callable[[int], bool] = lambda _node: False
        self.denies_control = False
        self.objects: dict[tuple[int, int, int], bytes | int] = {}
        self.without_tpdo: set[int] = set()
        self.short_tpdo: set[int] = set()
        self.doubling_tpdo: set[int] = set()
        self.offline: set[int] = set()
        self.started: set[int] = set()
        self.not_following: set[int] = set()
        self.inverted_bits: dict[int, int] = {}
        """Bits of 6041h that are inverted in the answers to SYNC, by joint."""
        self.token = 0
        self.other_master: tuple[tuple[int, bytes], ...] = ()
        self._next_cycle = 0.0
        self.document = b""
        self.written: bytes | None = None
        self.refusal = ""
        self.corrupts = False
        self.wrong_digest = False
        self.drops: Callable[[int, bytes], bool] = lambda _identifier, _data: False
        """Which SDO frames, NMT commands and boot-up messages are lost."""
        self.staged = False
        self.on_sync: Callable[[int], None] = lambda _sync: None
        self._actions: dict[int, Callable[[], object]] = {}
        self.on_send: Callable[[int, bytes], None] = lambda _identifier, _data: None
        """Called before each frame, in the sender's thread."""
        self.on_closing: Callable[[], None] = lambda: None
        """Called when the second handle is closed, just before the bus itself."""
        self.io_error: Exception | None = None
        self._queue: deque[tuple[int, bytes]] = deque()
        self._wake = threading.Condition()
        self._next_beat = 0.0
        super().__init__(channel="fake")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.io_error is not None:
            raise self.io_error
        self.on_send(msg.arbitration_id, bytes(msg.data))
        with self._wake:
            self.sent.append((msg.arbitration_id, bytes(msg.data)))
            self._handle(msg.arbitration_id, bytes(msg.data))
            self._wake.notify_all()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.io_error is not None:
            raise self.io_error
        with self._wake:
            self._beat()
            if not self._queue:
                self._wake.wait(timeout)
                self._beat()
            if not self._queue:
                return None, False
            identifier, data = self._queue.popleft()
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        message.timestamp = time.time()
        return message, False

    def stop_handle(self) -> Any:
        send = partial(FakeArmBus.send, self)
        shutdown = lambda: self.on_closing()  # noqa: E731, PLW0108 - tests set it later
        return SimpleNamespace(send=send, shutdown=shutdown, channel_info="fake")

    @property
    def statuses(self) -> set[int]:
        return {drive.status for drive in self.drives.values()}

    @property
    def commands(self) -> list[bytes]:
        return [data for identifier, data in self.sent if 0x200 < identifier <= 0x200 + JOINTS]

    def controlwords(self, joint: int, since: int = 0) -> list[int]:
        """Controlwords sent to a joint, without those in the first `since` frames."""
        frames = [data for i, data in self.sent[since:] if i == 0x200 + joint]
        return [struct.unpack("<Hib", data)[0] for data in frames]

    def inject(self, identifier: int, data: bytes) -> None:
        with self._wake:
            self._queue.append((identifier, data))
            self._wake.notify_all()

    def at(self, syncs: int, act: Callable[[], object]) -> None:
        """Do something at a SYNC, so many from now."""
        self._actions[self.syncs + syncs] = act

    def emergency(self, node: int, code: int) -> None:
        self.inject(0x80 + node, struct.pack("<HB5x", code, 0x81))

    def trip(self, joint: int, code: int) -> None:
        """Put a drive into the state fault, with an emergency message."""
        with self._wake:  # a concurrent command must not reset the fault
            self.drives[joint].status = 0x08
            self.emergency(joint, code)

    def _beat(self) -> None:
        now = time.monotonic()
        if self.other_master and now >= self._next_cycle:
            self._next_cycle = now + 0.01
            self._queue.extend(self.other_master)
        if now < self._next_beat:
            return
        self._next_beat = now + 0.1
        for node in (*self.drives, SUPERVISOR):
            if node not in self.offline | self.without_heartbeat:
                state = b"\x05" if node in self.started else b"\x7f"
                self._queue.append((0x700 + node, state))

    def _handle(self, identifier: int, data: bytes) -> None:
        if identifier == 0x000:
            if not self.drops(identifier, data):
                self._nmt(*data)
        elif identifier == 0x080 and self.started:
            self.syncs += 1
            self._actions.pop(self.syncs, lambda: None)()
            self.on_sync(self.syncs)
            servo(self.drives.values())
            for joint, drive in self.drives.items():
                if joint in self.without_tpdo | self.offline or joint not in self.started:
                    continue
                counts = drive.counts + drive.noise(self.syncs)
                follows = (drive.status, drive.mode) == (0x27, 8)
                bits = 0x1210 if follows and joint not in self.not_following else 0x0210
                status = (drive.status | bits) ^ self.inverted_bits.get(joint, 0)
                frame = struct.pack("<Hih", status, counts, drive.torque)
                if joint in self.short_tpdo:
                    frame = frame[:-2]
                for _ in range(2 if joint in self.doubling_tpdo else 1):
                    self._queue.append((0x180 + joint, frame))
        elif 0x201 <= identifier <= 0x200 + JOINTS:
            drive = self.drives[identifier - 0x200]
            faulted = drive.status == 0x08
            drive.rpdo(data)
            if faulted and drive.status != 0x08:  # CiA 301: error reset or no error
                self._queue.append((identifier - 0x180, bytes(8)))
        elif 0x601 <= identifier <= 0x67F:
            node = identifier - 0x600
            dropped = self.drops(identifier, data)
            if node in self._servers and node not in self.offline and not dropped:
                self._servers[node].on_request(identifier, data, 0.0)

    def _nmt(self, command: int, number: int) -> None:
        for node in {*self.drives, SUPERVISOR} - self.offline:
            if number not in (0, node):
                continue
            if command == 0x82:
                self.started.discard(node)
                if not self.drops(0x700 + node, b"\x00"):
                    self._queue.append((0x700 + node, b"\x00"))
                self._queue.append((0x700 + node, b"\x7f"))
            elif command == 0x01 and node not in self.never_starts:
                self.started.add(node)
                self._next_beat = 0.0

    def answer(self, node: int, data: bytes) -> None:
        if self.drops(0x580 + node, data):
            return
        for _ in range(2 if self.duplicates_response(node) else 1):
            self._queue.append((0x580 + node, data))

    def set_heartbeat_consumers(self, node: int, *entries: tuple[int, int]) -> None:
        """Set 1016h of a node: producer nodes and time-outs, ms."""
        self.objects[node, 0x1016, 0] = bytes([len(entries)])
        for sub, (producer, time_ms) in enumerate(entries, 1):
            self.objects[node, 0x1016, sub] = struct.pack("<L", producer << 16 | time_ms)

    def object_of(self, node: int, index: int, sub: int) -> bytes | int:
        """Return the bytes of an object, or the abort code."""
        if (node, index, sub) in self.objects:
            return self.objects[node, index, sub]
        if node != SUPERVISOR and index in MAPS:
            return struct.pack("<L", MAPS[index][sub]) if sub < len(MAPS[index]) else 0x06090011
        own = self._of_supervisor() if node == SUPERVISOR else self._of_drive(node)
        common = {
            (0x1017, 0): struct.pack("<H", 100),
            (0x1018, 1): bytes(4),
            (0x1018, 2): b"\x01\0\0\0",
            (0x1018, 3): b"\0\0\x01\0",
            (0x1018, 4): struct.pack("<L", 7000 + node),
        }
        return (common | own).get((index, sub), 0x06020000)

    def _of_drive(self, node: int) -> dict[tuple[int, int], bytes | int]:
        limit = round(COUNTS_PER_REV / 4)
        rvdt = node == JOINTS
        return {
            (0x1000, 0): struct.pack("<L", 0x00020192),
            (0x1005, 0): struct.pack("<L", 0x80),
            (0x1008, 0): b"fake drive",
            (0x1014, 0): struct.pack("<L", 0x80 + node),
            (0x1400, 1): struct.pack("<L", 0x200 + node),
            (0x1400, 2): b"\xfe",
            (0x1800, 1): struct.pack("<L", 0x40000180 + node),
            (0x1800, 2): b"\x01",
            (0x6064, 0): struct.pack("<l", self.drives[node].counts),
            (0x603F, 0): b"\x11\x86",
            (0x6041, 0): struct.pack("<H", self.drives[node].status | 0x0210),
            (0x6061, 0): struct.pack("<b", self.drives[node].mode),
            (0x6076, 0): struct.pack("<L", 50_000),
            (0x607C, 0): struct.pack("<l", -11 * node if self.document else 0),
            (0x607D, 1): struct.pack("<l", -4096 // 4 if rvdt else -limit),
            (0x607D, 2): struct.pack("<l", 4096 // 4 if rvdt else limit),
            (0x608F, 1): struct.pack("<L", COUNTS_PER_REV),
            (0x608F, 2): struct.pack("<L", 1),
            (0x60C2, 1): b"\x0a",
            (0x60C2, 2): b"\xfd",
            (0x2100, 1): b"\x02" if rvdt else b"\x01",
            (0x2100, 2): struct.pack("<L", 120_000_000),
            (0x2100, 3): b"\x0c",
        }

    def _of_supervisor(self) -> dict[tuple[int, int], bytes | int]:
        document = self.document if self.written is None else self.written
        return {
            (0x1000, 0): bytes(4),
            (0x1008, 0): b"fake supervisor",
            (0x2000, 0): document or 0x08000024,
            (0x2001, 1): bytes(32) if self.wrong_digest else hashlib.sha256(document).digest(),
            (0x2001, 2): struct.pack("<L", len(document)),
            (0x2003, 1): b"\x01" if self.document else b"\x00",
            (0x2003, 4): bytes([self.staged]),
            (0x2004, 0): self.refusal.encode() or 0x08000024,
            (0x2010, 0): struct.pack("<L", self.token),
            (0x2020, 1): b"fake",
            (0x2020, 2): b"FAKE-1",
            (0x2020, 3): bytes([JOINTS]),
        }

    def store(self, index: int, value: bytes) -> None:
        if index == 0x2010:
            node = int.from_bytes(value, "little")
            if node and (self.denies_control or self.token not in (0, node)):
                raise SdoAbortedError(0x08000022)
            self.token = node
        elif index == 0x2000:
            self.written = value[:-1] + b"?" if self.corrupts else value
        elif index == 0x2002 and value == b"\x01":
            if self.refusal:
                self.written = None
                raise SdoAbortedError(0x08000020)
            self.staged = True
        elif index == 0x2002 and value == b"\x02" and self.written is not None:
            self.document, self.written, self.staged = self.written, None, False
        elif index == 0x2002:
            self.written, self.staged = None, False
        else:
            raise SdoAbortedError(0x06020000)


def capture_for_ever(arm: Any) -> None:
    while True:
        arm.capture(5)

"""A CANopen peer of python-can frames, the `canopen` package's SDO client, and numbers of CiA 301 and CiA 402."""

import struct
import time
from collections.abc import Callable
from types import SimpleNamespace

import can
import canopen
from canopen.sdo import SdoClient

JOINTS = 7
PATIENCE_S = 60.0
"""Longest delay of a frame on a busy machine."""


class RawPeer:
    """Sends and receives on one bus; `log` has every received frame."""

    def __init__(self, bus: can.BusABC) -> None:
        self.bus = bus
        self.log: list[tuple[int, bytes]] = []

    def send(self, identifier: int, data: bytes = b"") -> None:
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def receive(self, timeout_s: float) -> tuple[int, bytes] | None:
        message = self.bus.recv(timeout_s)
        if message is None:
            return None
        frame = (message.arbitration_id, bytes(message.data))
        self.log.append(frame)
        return frame

    def wait_for(self, condition: Callable[[int, bytes], bool]) -> tuple[int, bytes]:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            frame = self.receive(0.05)
            if frame is not None and condition(*frame):
                return frame
        raise TimeoutError(f"no such frame; last frames: {self.log[-8:]}")

    def quiet(self) -> None:
        while self.receive(0.0) is not None:
            pass

    def seen(self, identifier: int) -> list[bytes]:
        return [data for number, data in self.log if number == identifier]

    def nmt(self, command: int, node: int = 0) -> None:
        self.send(0x000, bytes([command, node]))

    def beat(self, node: int = 127) -> None:
        self.send(0x700 + node, b"\x05")

    def sync(self) -> list[tuple[int, int, int]]:
        """Send a SYNC; return statusword, position, torque of every joint, which answer in order."""
        self.send(0x080)
        answers: list[tuple[int, bytes]] = []
        while len(answers) < JOINTS:
            answers.append(self.wait_for(lambda number, _: 0x180 < number <= 0x180 + JOINTS))
        assert [number for number, _ in answers] == [0x181 + k for k in range(JOINTS)]
        return [struct.unpack("<Hih", data) for _, data in answers]

    def command(self, joint: int, controlword: int, target: int, mode: int) -> None:
        self.send(0x200 + joint, struct.pack("<Hib", controlword, target, mode))

    def command_all(self, *controlwords: int) -> None:
        """Send controlwords to every joint, with target 0 in position mode."""
        for joint in range(1, JOINTS + 1):
            for word in controlwords:
                self.command(joint, word, 0, 8)

    def _client(self, node: int) -> SdoClient:
        client = SdoClient(0x600 + node, 0x580 + node, canopen.ObjectDictionary())
        client.network = SimpleNamespace(send_message=self.send)
        client.responses = SimpleNamespace(
            empty=lambda: True,
            get=lambda **_: self.wait_for(lambda number, _: number == client.tx_cobid)[1],
        )
        return client

    def read(self, node: int, index: int, sub: int = 0) -> bytes:
        with self._client(node).open(index, sub, buffering=0) as stream:
            data = bytes(stream.read())
            assert len(data) == stream.size
            return data

    def write(self, node: int, index: int, sub: int, data: bytes) -> None:
        self._client(node).download(index, sub, data)

    def unsigned(self, node: int, index: int, sub: int = 0) -> int:
        return int.from_bytes(self.read(node, index, sub), "little")

    def signed(self, node: int, index: int, sub: int = 0) -> int:
        return int.from_bytes(self.read(node, index, sub), "little", signed=True)

    def start(self) -> None:
        """Set all nodes operational."""
        self.nmt(1)

    def take_control(self) -> None:
        self.beat()
        self.write(16, 0x2010, 0, struct.pack("<I", 127))

    def enable(self, modes: list[int]) -> list[tuple[int, int, int]]:
        """Enable all drives in the given modes, at their positions."""
        states = self.sync()
        for word in (0x06, 0x07, 0x0F):
            for joint, mode in enumerate(modes, start=1):
                self.command(joint, word, states[joint - 1][1], mode)
            states = self.sync()
        for _ in range(4):
            states = self.sync()
        return states

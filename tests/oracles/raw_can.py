"""A CANopen peer of python-can frames and literal numbers from CiA 301 and CiA 402; shares no code with us."""

import struct
import time
from collections.abc import Callable

import can


class RawAbort(Exception):
    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"{code:08X}h")


class RawPeer:
    """Sends and receives on one bus; `log` has every received frame."""

    def __init__(self, bus: can.BusABC, joints: int = 7, timeout_s: float = 60.0) -> None:
        self.bus, self.joints, self.timeout_s = bus, joints, timeout_s
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
        deadline = time.monotonic() + self.timeout_s
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
        while len(answers) < self.joints:
            answers.append(self.wait_for(lambda number, _: 0x180 < number <= 0x180 + self.joints))
        assert [number for number, _ in answers] == [0x181 + k for k in range(self.joints)]
        return [struct.unpack("<Hih", data) for _, data in answers]

    def command(self, joint: int, controlword: int, target: int, mode: int) -> None:
        self.send(0x200 + joint, struct.pack("<Hib", controlword, target, mode))

    def _ask(self, node: int, request: bytes) -> bytes:
        self.send(0x600 + node, request)
        answer = self.wait_for(lambda number, _: number == 0x580 + node)[1]
        assert len(answer) == 8
        if answer[0] == 0x80:
            assert answer[1:4] == request[1:4] or request[0] < 0x20 or 0x60 <= request[0] < 0x80
            raise RawAbort(struct.unpack_from("<I", answer, 4)[0])
        return answer

    def read(self, node: int, index: int, sub: int = 0) -> bytes:
        answer = self._ask(node, struct.pack("<BHB4x", 0x40, index, sub))
        assert struct.unpack_from("<HB", answer, 1) == (index, sub)
        if answer[0] & 0x02:
            assert answer[0] & 0x01
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        assert answer[0] == 0x41
        size = struct.unpack_from("<I", answer, 4)[0]
        data, toggle = b"", 0
        while True:
            answer = self._ask(node, bytes([0x60 | toggle]) + bytes(7))
            assert answer[0] & 0xF0 == toggle
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            toggle ^= 0x10
            if answer[0] & 1:
                assert len(data) == size
                return data

    def write(self, node: int, index: int, sub: int, data: bytes) -> None:
        if 1 <= len(data) <= 4:
            head = 0x23 | (4 - len(data)) << 2
            answer = self._ask(node, struct.pack("<BHB", head, index, sub) + data.ljust(4, b"\0"))
            assert answer == struct.pack("<BHB4x", 0x60, index, sub)
            return
        answer = self._ask(node, struct.pack("<BHBI", 0x21, index, sub, len(data)))
        assert answer == struct.pack("<BHB4x", 0x60, index, sub)
        toggle = 0
        for start in range(0, len(data), 7):
            part = data[start : start + 7]
            last = start + 7 >= len(data)
            head = toggle | (7 - len(part)) << 1 | last
            answer = self._ask(node, bytes([head]) + part.ljust(7, b"\0"))
            assert answer[0] == 0x20 | toggle
            toggle ^= 0x10

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

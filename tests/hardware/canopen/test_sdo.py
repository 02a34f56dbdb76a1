"""A node that does not end its answer to a read ends neither the program nor STOP."""

import gc

import pytest

from hardware.canopen.sdo import MAX_OBJECT_BYTES, ObjectAccess
from hardware.errors import BusError, EndlessAnswer, Stopped
from tests.hardware.control.canopen_arm.conftest import make
from tests.hardware.fake_arm import FakeArmBus


class EndlessNode:
    """Sends segments of which none is the last, each `answer_s` after its request; the size that it states is 20."""

    def __init__(self, answer_s: float) -> None:
        self.now_s, self._answer_s = 0.0, answer_s
        self.requests: list[bytes] = []
        self.access = ObjectAccess(self.take, [2], clock=lambda: self.now_s)

    def take(self, identifier: int, data: bytes) -> None:
        self.requests.append(data)
        self.now_s += self._answer_s
        toggle = bytes([data[0] & 0x10])
        answers = {0x40: b"\x41" + data[1:4] + b"\x14\0\0\0", 0x60: toggle + b"endless"}
        if (kind := data[0] & 0xE0) in answers:
            self.access.deliver(identifier - 0x80, answers[kind])


@pytest.mark.parametrize(("answer_s", "received"), [(1e-3, MAX_OBJECT_BYTES), (0.9, 7 * 5.1 / 0.9)])
def test_endless_answer_is_aborted_after_its_limit(answer_s, received):
    node = EndlessNode(answer_s)
    with pytest.raises(EndlessAnswer, match=r"Node 2 .* 1008h sub 0: it has sent") as endless:
        node.access.read(2, 0x1008)
    assert endless.value.received == pytest.approx(received, abs=7)
    assert node.requests[-1][0] == 0x80
    assert sum(request[0] == 0x40 for request in node.requests) == 1, "no second attempt"


@pytest.mark.parametrize("answered", [0, 1, 2])
def test_failed_write_sends_nothing_after_its_abort(answered):
    requests: list[bytes] = []

    def take(identifier: int, data: bytes) -> None:
        requests.append(data)
        if len(requests) <= answered:
            answer = 0x60 if data[0] & 0xE0 == 0x20 else 0x20
            access.deliver(identifier - 0x80, bytes([answer]) + data[1:4] + bytes(4))

    access = ObjectAccess(take, [2], timeout_s=0.01)
    with pytest.raises(BusError, match="Node 2 "):
        access.write(2, 0x2000, 0, b"a document of several segments")
    gc.collect()  # closes the stream
    kinds = [request[0] & 0xE0 for request in requests]
    assert kinds == [0x20, *[0] * answered, 0x80]


def test_stop_ends_a_read_while_connecting():
    bus, segments = FakeArmBus(), list[int]()
    bus.objects[2, 0x1008, 0] = b"n" * 4000

    def stop_at_the_tenth_segment(identifier: int, data: bytes) -> None:
        if identifier == 0x602 and data[0] & 0xE0 == 0x60:
            segments.append(len(bus.sent))
            if len(segments) == 10:
                arm.stop()

    arm, bus.on_send = make(bus), stop_at_the_tenth_segment
    with pytest.raises(Stopped, match="while connecting"):
        arm.connect()
    assert len(segments) == 10
    assert bus.sent[-1] == (0x602, bytes.fromhex("8000000000000008"))

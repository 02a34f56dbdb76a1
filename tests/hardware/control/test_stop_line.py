"""STOP's latch and frames: every drive gets its quick stop, whatever happens to the others'."""

import errno
import itertools
import struct
from collections.abc import Mapping

import can
import pytest

from hardware.buses.shared_bus import SharedBus
from hardware.canopen.cyclic import Setpoint, frames_of
from hardware.control.stop_line import StopLatch, StopLine
from hardware.errors import BusError
from tests.oracles.profiles import sarcos

COUNTS = (11, -22, 33)
ALL = [0x201, 0x202, 0x203]


class FakeBus(can.BusABC):
    """Takes every frame but those it has an exception for."""

    def __init__(self, failing: Mapping[int, Exception] | None = None) -> None:
        self.failing = failing or {}
        self.sent: list[tuple[int, bytes]] = []
        super().__init__(channel="fake")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        assert timeout == 0.0, "STOP waits for nothing"
        if msg.arbitration_id in self.failing:
            raise self.failing[msg.arbitration_id]
        self.sent.append((msg.arbitration_id, bytes(msg.data)))


CLOSED = ValueError("file descriptor cannot be a negative integer (-1)")
FAILURES = [CLOSED, OSError("network is down"), can.CanOperationError("full"), TypeError("closed")]


@pytest.fixture
def own():
    return FakeBus()


@pytest.fixture
def spare():
    return FakeBus()


def line(own: FakeBus, spare: FakeBus) -> StopLine:
    return StopLine(own, SharedBus(spare), frames_of(sarcos(3)))


def test_quick_stop_keeps_target_and_mode(own, spare):
    given = tuple(Setpoint(0x0F, target, mode) for target, mode in ((1, 8), (2, 10), (3, 8)))
    line(own, spare).send(given, COUNTS)
    frames = [(i, struct.unpack("<Hib", data)) for i, data in own.sent]
    assert frames == [(0x201, (2, 1, 8)), (0x202, (2, 2, 10)), (0x203, (2, 3, 8))]
    assert spare.sent == []


def test_full_transmit_queue_does_not_lose_stop_frames():
    """Both handles stand before the same queue."""
    space = can.CanOperationError("Failed to transmit", errno.ENOBUFS)

    class Full(FakeBus):
        offered = 0

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            Full.offered += 1
            if Full.offered % 7:
                raise space
            super().send(msg, timeout)

    own, spare = Full(), Full()
    line(own, spare).send(None, COUNTS)
    assert sorted(identifier for identifier, _ in own.sent + spare.sent) == ALL


def test_stop_before_first_command_targets_current_position(own, spare):
    line(own, spare).send(None, COUNTS)
    assert [struct.unpack("<Hib", data) for _, data in own.sent] == [(2, c, 8) for c in COUNTS]


@pytest.mark.parametrize("failure", FAILURES, ids=lambda failure: type(failure).__name__)
def test_refused_stop_frame_is_sent_by_second_handle(own, spare, failure):
    own.failing = {0x202: failure}
    line(own, spare).send(None, COUNTS)
    assert [i for i, _ in own.sent] == [0x201, 0x203]
    assert [i for i, _ in spare.sent] == [0x202]


@pytest.mark.parametrize("failure", FAILURES, ids=lambda failure: type(failure).__name__)
@pytest.mark.parametrize("joint", [1, 2, 3])
def test_undeliverable_stop_frame_does_not_block_others(own, spare, joint, failure):
    own.failing = dict.fromkeys(ALL, CLOSED)
    spare.failing = {0x200 + joint: failure}
    with pytest.raises(
        BusError, match=r"could not be sent: .*[^.]\. Use the emergency stop"
    ) as said:
        line(own, spare).send(None, COUNTS)
    assert str(failure) in str(said.value)
    assert [i for i, _ in spare.sent] == [i for i in ALL if i != 0x200 + joint]


def test_latch_is_released_only_for_latest_press():
    latch = StopLatch()
    assert not latch.latched
    assert latch.release(latch.last_press)
    seen = []
    for _ in range(3):
        latch.press()
        seen.append(latch.last_press)
        assert latch.latched
    for earlier in (None, *seen[:-1]):
        assert not latch.release(earlier)
        assert latch.latched
    assert latch.release(seen[-1])
    for again in (seen[-1], None, seen[0]):
        assert not latch.latched
        assert latch.release(again)
    assert not latch.latched
    for press in seen:
        latch.press()
        assert not latch.release(press), "what was released before lifts nothing new"
    assert all(a is not b for a, b in itertools.combinations(seen, 2))

"""STOP's latch and frames: every drive gets its quick stop, even if frames to others fail."""

import errno
import itertools
import struct

import can
import pytest

from hardware.arm import JointMode
from hardware.buses.shared_bus import SharedBus
from hardware.canopen.cyclic import Setpoint, frames_of
from hardware.control import stop_line
from hardware.control.stop_line import StopLatch, StopLine
from hardware.errors import BusError
from tests.oracles.profiles import sarcos

COUNTS = (11, -22, 33)
ALL = [0x201, 0x202, 0x203]
CLOSED = ValueError("file descriptor cannot be a negative integer (-1)")
FAILURES = [CLOSED, OSError("network is down"), can.CanOperationError("full"), TypeError("closed")]


class FakeBus(can.BusABC):
    """Takes every frame but those with an exception in `failing`."""

    def __init__(self) -> None:
        self.failing: dict[int, Exception] = {}
        self.sent: list[tuple[int, bytes]] = []
        super().__init__(channel="fake")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        assert timeout == 0.0, "STOP waits for nothing"
        if msg.arbitration_id in self.failing:
            raise self.failing[msg.arbitration_id]
        self.sent.append((msg.arbitration_id, bytes(msg.data)))

    @property
    def setpoints(self) -> list[tuple[int, ...]]:
        return [struct.unpack("<Hib", data) for _, data in self.sent]


@pytest.fixture
def main():
    return FakeBus()


@pytest.fixture
def spare():
    return FakeBus()


def line(main: FakeBus, spare: FakeBus) -> StopLine:
    return StopLine(main, SharedBus(spare), frames_of(sarcos(3)))


def test_quick_stop_keeps_target_and_mode(main, spare):
    modes = JointMode.POSITION, JointMode.FREE, JointMode.POSITION
    setpoints = tuple(Setpoint(0x0F, target, mode) for target, mode in enumerate(modes, 1))
    line(main, spare).send(setpoints, COUNTS)
    assert [identifier for identifier, _ in main.sent] == ALL
    assert main.setpoints == [(2, 1, 8), (2, 2, 10), (2, 3, 8)]
    assert spare.sent == []


def test_full_transmit_queue_does_not_lose_stop_frames(monkeypatch):
    """Both handles share the kernel's queue. A busy machine may need more than a control period for seven attempts."""
    monkeypatch.setattr(stop_line, "CONTROL_PERIOD_S", 60.0)
    full = can.CanOperationError("Failed to transmit", errno.ENOBUFS)
    attempts = itertools.count(1)

    class Full(FakeBus):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            if next(attempts) % 7:
                raise full
            super().send(msg, timeout)

    main, spare = Full(), Full()
    line(main, spare).send(None, COUNTS)
    assert sorted(identifier for identifier, _ in main.sent + spare.sent) == ALL


def test_stop_before_first_command_targets_current_position(main, spare):
    line(main, spare).send(None, COUNTS)
    assert main.setpoints == [(2, counts, 8) for counts in COUNTS]


@pytest.mark.parametrize("failure", FAILURES, ids=lambda failure: type(failure).__name__)
def test_refused_stop_frame_is_sent_by_second_handle(main, spare, failure):
    main.failing = {0x202: failure}
    line(main, spare).send(None, COUNTS)
    assert [i for i, _ in main.sent] == [0x201, 0x203]
    assert [i for i, _ in spare.sent] == [0x202]


@pytest.mark.parametrize("failure", FAILURES, ids=lambda failure: type(failure).__name__)
@pytest.mark.parametrize("joint", [1, 2, 3])
def test_undeliverable_stop_frame_does_not_block_others(main, spare, joint, failure):
    main.failing = dict.fromkeys(ALL, CLOSED)
    spare.failing = {0x200 + joint: failure}
    with pytest.raises(
        BusError, match=r"could not be sent: .*[^.]\. Use the emergency stop"
    ) as error:
        line(main, spare).send(None, COUNTS)
    assert str(failure) in str(error.value)
    assert [i for i, _ in spare.sent] == [i for i in ALL if i != 0x200 + joint]


def test_latch_is_released_only_for_latest_press():
    latch = StopLatch()
    assert not latch.latched
    assert latch.release(latch.last_press)
    presses = []
    for _ in range(3):
        latch.press()
        presses.append(latch.last_press)
        assert latch.latched
    for earlier in (None, *presses[:-1]):
        assert not latch.release(earlier)
        assert latch.latched
    for press in (presses[-1], presses[-1], None, presses[0]):
        assert latch.release(press)
        assert not latch.latched
    for press in presses:
        latch.press()
        assert not latch.release(press), "an earlier press releases no later one"
    assert all(a is not b for a, b in itertools.combinations(presses, 2))

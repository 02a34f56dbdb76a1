"""Connecting over a bus that loses frames: present nodes are found, and a poor bus is reported early."""

import itertools
import re
from collections.abc import Callable

import pytest

from hardware.canopen.sdo import ObjectAccess
from hardware.errors import BusError, FramesLost
from tests.hardware.control.canopen_arm.conftest import make, short_timing
from tests.hardware.fake_arm import FakeArmBus, FrameLoss

TIMING = short_timing(sdo_timeout_s=0.05)


def one_in(count: int) -> Callable[[int, bytes], bool]:
    """Lose every n-th SDO frame; aborts, which are not answered, do not count."""
    numbers = itertools.count(1)

    def drops(identifier: int, data: bytes) -> bool:
        return 0x580 < identifier < 0x680 and data[0] != 0x80 and next(numbers) % count == 0

    return drops


def requests(bus: FakeArmBus) -> int:
    return sum(0x600 < i < 0x680 and data[0] != 0x80 for i, data in bus.sent)


def test_ten_percent_frame_loss_raises_frames_lost_early(bus):
    bus.drops = one_in(10)
    with pytest.raises(FramesLost, match=r"of the requests \d of \d+ to node 1") as lost:
        make(bus, timing=TIMING).connect()
    unanswered, sent = map(sum, zip(*lost.value.requests.values(), strict=True))
    assert unanswered == 8
    assert sent <= requests(bus) < 60, "of more than 500"


def test_one_percent_frame_loss_is_tolerated(connected, bus):
    bus.drops = one_in(100)
    connected(timing=TIMING)
    assert requests(bus) > 500


def test_single_attempts_do_not_count_as_frame_loss():
    """Drives in the NMT state STOPPED do not answer the state check that precedes their reset."""
    lost = [True] * 16 + [False] * 8 + [True]

    def send(identifier: int, data: bytes) -> None:
        if data[0] != 0x80 and not (lost and lost.pop(0)):
            access.deliver(identifier - 0x80, b"\x43" + data[1:4] + b"\x07\0\0\0")

    nodes = range(1, 9)
    access = ObjectAccess(send, nodes, timeout_s=0.01)
    for node in (*nodes, *nodes):
        with pytest.raises(BusError):
            access.read_once(node, 0x6041)
    assert [access.read_unsigned(node, 0x1000) for node in (*nodes, *nodes)] == [7] * 16
    assert not lost


def test_single_unanswered_object_is_no_frame_loss(bus):
    bus.drops = lambda identifier, data: (identifier, data[1:3]) == (0x604, b"\x14\x10")
    with pytest.raises(BusError, match="Node 4 does not answer when asked for 1014h") as silent:
        make(bus, timing=TIMING).connect()
    assert not isinstance(silent.value, FramesLost)
    assert re.search(r"It has answered \d+ of \d+ requests", str(silent.value))


@pytest.mark.parametrize(
    ("identifier", "frame"),
    [
        *((0x000, bytes([command, node])) for command in (0x82, 0x01) for node in (4, 16)),
        (0x704, b"\x00"),
    ],
)
def test_lost_nmt_command_or_boot_up_is_repeated(connected, bus, identifier, frame):
    bus.drops = FrameLoss(identifier, frame)
    arm = connected()
    arm.take_control()
    assert arm.capture(2).samples == 2, "a second boot-up is no restart here"

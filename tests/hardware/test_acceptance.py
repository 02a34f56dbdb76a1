"""Foreign frames are kept out where an adapter can, and never pass for an empty queue where none can."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import ExitStack

import can
import pytest

from hardware.acceptance import controller_filters, keep_out
from hardware.loopback import LoopbackBus
from hardware.wire import Wire

FOREIGN, SYNC, NMT = 0x123, 0x080, 0x000


def pair(interface: str, stack: ExitStack) -> tuple[can.BusABC, can.BusABC]:
    channel = f"keep-{uuid.uuid4().hex[:8]}"
    one, other = (
        LoopbackBus(channel) if interface == "loopback" else can.Bus(channel, interface="virtual")
        for _ in range(2)
    )
    stack.callback(one.shutdown)
    stack.callback(other.shutdown)
    return one, other


@pytest.fixture(params=["loopback"])
def buses(request: pytest.FixtureRequest) -> Iterator[tuple[can.BusABC, can.BusABC]]:
    with ExitStack() as stack:
        yield pair(request.param, stack)


def test_an_answer_behind_foreign_frames_is_found_without_waiting(
    buses: tuple[can.BusABC, can.BusABC],
) -> None:
    arm, talker = buses
    keep_out(arm, controller_filters(7))
    for identifier in (SYNC, FOREIGN, FOREIGN + 1, NMT):
        talker.send(can.Message(arbitration_id=identifier, is_extended_id=False))
    wire = Wire(arm)
    first = wire.receive(1.0)
    found = [first]
    while found[-1] is not None:
        found.append(wire.receive(0.0))
    assert NMT in {message.arbitration_id for message in found if message is not None}


def test_a_kernel_keeps_them_out() -> None:
    with ExitStack() as stack:
        arm, talker = pair("loopback", stack)
        keep_out(arm, controller_filters(7))
        for identifier in (FOREIGN, SYNC):
            talker.send(can.Message(arbitration_id=identifier, is_extended_id=False))
        message = arm.recv(1.0)
        assert message is not None
        assert message.arbitration_id == SYNC

import time
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import can
import pytest

from hardware.buses.python_can import open_bus, open_sender
from hardware.errors import BusError

PATIENCE_S = 60.0
"""Longest delay of a frame on a busy machine."""


@pytest.fixture
def opener(settings):
    with ExitStack() as stack:
        yield lambda **options: stack.enter_context(open_bus(replace(settings, options=options)))


def frame(identifier: int, data: bytes = b"", **options: Any) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, **{"is_extended_id": False, **options})


FRAMES = {
    **{f"standard-{n}": frame(0x181, bytes(range(n))) for n in range(9)},
    "lowest": frame(0),
    "highest": frame(0x7FF),
    "extended": frame(0x1FFFFFFF, b"\xff" * 8, is_extended_id=True),
    "extended-low": frame(0x181, b"a", is_extended_id=True),
    "remote": can.Message(arbitration_id=0x701, is_remote_frame=True, dlc=1, is_extended_id=False),
    "error": frame(0x20, b"\x01" * 8, is_error_frame=True),
}


@pytest.mark.parametrize("sent", FRAMES.values(), ids=FRAMES.keys())
def test_received_frame_equals_sent_frame(opener, sent):
    sender, receiver = opener(), opener()
    sender.send(sent)
    received = receiver.recv(PATIENCE_S)
    # is_rx is not required: socketcan says false for every frame of this machine.
    assert received.equals(sent, timestamp_delta=None, check_direction=False, check_channel=False)


def test_frame_reaches_all_other_handles_but_not_its_own(opener):
    buses = [opener() for _ in range(3)]
    buses[1].send(FRAMES["standard-8"])
    assert buses[0].recv(PATIENCE_S) is not None
    assert buses[2].recv(PATIENCE_S) is not None
    assert buses[1].recv(0.0) is None


def test_burst_arrives_complete_and_in_order(opener):
    sender, receiver = opener(), opener()
    count = 200  # a socketcan receive buffer of default size holds a few hundred
    for number in range(count):
        sender.send(frame(0x100, number.to_bytes(4, "little")))
    for number in range(count):
        received = receiver.recv(PATIENCE_S)
        assert received is not None, f"frame {number} did not arrive"
        assert int.from_bytes(received.data, "little") == number


@pytest.mark.campaign
@pytest.mark.real_time
def test_timestamps_are_arrival_times(opener):
    sender, receiver = opener(), opener()
    delay_s = 0.2
    slack_s = 0.005  # kernel and interpreter may read different clocks
    stamped = False
    while not stamped:  # a kernel stamps only a moment after the first socket has asked for it
        sender.send(FRAMES["standard-0"])
        after = time.time()
        assert sender.recv(0.05) is None
        stamped = receiver.recv(PATIENCE_S).timestamp <= after + slack_s
    before = time.time()
    sender.send(FRAMES["standard-1"])
    sender.send(FRAMES["standard-2"])
    after = time.time()
    assert sender.recv(delay_s) is None
    first, second = receiver.recv(PATIENCE_S), receiver.recv(PATIENCE_S)
    assert before - slack_s <= first.timestamp <= second.timestamp <= after + slack_s
    # They are not the times of reading.
    assert time.time() - second.timestamp > delay_s / 2


def test_filters_pass_only_matching_identifiers(opener):
    sender = opener()
    receiver = opener(can_filters=[{"can_id": 0x180, "can_mask": 0x7F0, "extended": False}])
    for identifier in (0x080, 0x181, 0x701, 0x187):
        sender.send(frame(identifier))
    received = [receiver.recv(PATIENCE_S), receiver.recv(PATIENCE_S)]
    assert [message and message.arbitration_id for message in received] == [0x181, 0x187]


def test_recv_on_empty_bus_returns_at_timeout(opener):
    bus = opener()
    assert bus.recv(0.0) is None
    begun_s = time.monotonic()
    assert bus.recv(0.05) is None
    assert 0.04 <= time.monotonic() - begun_s < PATIENCE_S


def test_sender_handle_receives_nothing_and_second_shutdown_is_harmless(opener, settings):
    if settings.interface == "virtual":  # it would queue frames for a handle that only sends
        with pytest.raises(BusError, match="opened only once"):
            open_sender(settings)
        return
    bus, other, sender = opener(), opener(), open_sender(settings)
    bus.send(FRAMES["standard-8"])
    sender.send(FRAMES["standard-2"])
    assert bus.recv(PATIENCE_S).dlc == 2
    assert sender.recv(0.0) is None
    for handle in (sender, sender, other, other):
        handle.shutdown()
    opener().send(FRAMES["standard-4"])
    assert bus.recv(PATIENCE_S).dlc == 4, "the channel is closed"

"""What every CAN transport must do."""

import threading
import time
from typing import Any

import can
import pytest

from hardware.buses.python_can import BusSettings, open_bus, open_sender


@pytest.fixture
def opener(settings):
    opened: list[can.BusABC] = []

    def open_one(**options: Any) -> can.BusABC:
        bus = open_bus(
            BusSettings(interface=settings.interface, channel=settings.channel, options=options)
        )
        opened.append(bus)
        return bus

    yield open_one
    for bus in opened:
        bus.shutdown()


FRAMES = {
    **{
        f"standard-{n}": can.Message(
            arbitration_id=0x181, data=bytes(range(n)), is_extended_id=False
        )
        for n in range(9)
    },
    "lowest": can.Message(arbitration_id=0, is_extended_id=False),
    "highest": can.Message(arbitration_id=0x7FF, is_extended_id=False),
    "extended": can.Message(arbitration_id=0x1FFFFFFF, data=b"\xff" * 8, is_extended_id=True),
    "extended-low": can.Message(arbitration_id=0x181, data=b"a", is_extended_id=True),
    "remote": can.Message(arbitration_id=0x701, is_remote_frame=True, dlc=1, is_extended_id=False),
    "error": can.Message(
        arbitration_id=0x20, is_error_frame=True, data=b"\x01" * 8, is_extended_id=False
    ),
}


@pytest.mark.parametrize("frame", FRAMES.values(), ids=FRAMES.keys())
def test_received_frame_equals_sent_frame(opener, frame):
    ours, theirs = opener(), opener()
    ours.send(frame)
    arrived = theirs.recv(2.0)
    assert arrived is not None
    # is_rx is no part of the contract: socketcan says false for every frame of this machine.
    assert arrived.equals(frame, timestamp_delta=None, check_direction=False, check_channel=False)


def test_own_frames_are_not_received(opener):
    ours, theirs = opener(), opener()
    ours.send(FRAMES["standard-8"])
    assert theirs.recv(2.0) is not None
    assert ours.recv(0.0) is None


def test_own_frames_are_received_on_request(opener):
    ours = opener(receive_own_messages=True)
    ours.send(FRAMES["standard-8"])
    echo = ours.recv(2.0)
    assert echo is not None
    assert not echo.is_rx


def test_frame_reaches_all_other_handles(opener):
    buses = [opener() for _ in range(3)]
    buses[1].send(FRAMES["standard-3"])
    assert buses[0].recv(2.0) is not None
    assert buses[2].recv(2.0) is not None


def test_burst_arrives_complete_and_in_order(opener):
    ours, theirs = opener(), opener()
    count = 200  # a socketcan receive buffer of default size holds a few hundred
    for number in range(count):
        ours.send(
            can.Message(
                arbitration_id=0x100, data=number.to_bytes(4, "little"), is_extended_id=False
            )
        )
    numbers = []
    while len(numbers) < count:
        arrived = theirs.recv(2.0)
        assert arrived is not None, f"frame {len(numbers)} did not arrive"
        numbers.append(int.from_bytes(arrived.data, "little"))
    assert numbers == list(range(count))


@pytest.mark.campaign
@pytest.mark.real_time
def test_timestamps_are_arrival_times(opener):
    ours, theirs = opener(), opener()
    before = time.time()
    ours.send(FRAMES["standard-1"])
    ours.send(FRAMES["standard-2"])
    sent = time.time()
    held_up_s = 0.2
    assert ours.recv(held_up_s) is None
    first, second = theirs.recv(2.0), theirs.recv(2.0)
    assert first is not None
    assert second is not None
    slack_s = 0.005  # kernel and interpreter may read different clocks
    assert before - slack_s <= first.timestamp <= second.timestamp <= sent + slack_s
    # What the reader would have stamped on them himself is out of the question.
    assert time.time() - second.timestamp > held_up_s / 2


def test_filters_pass_only_matching_identifiers(opener):
    ours = opener()
    theirs = opener(can_filters=[{"can_id": 0x180, "can_mask": 0x7F0, "extended": False}])
    for identifier in (0x080, 0x181, 0x701, 0x187):
        ours.send(can.Message(arbitration_id=identifier, is_extended_id=False))
    heard = [theirs.recv(2.0), theirs.recv(2.0)]
    assert [message and message.arbitration_id for message in heard] == [0x181, 0x187]


def test_recv_on_empty_bus_returns_at_timeout(opener):
    bus = opener()
    assert bus.recv(0.0) is None
    start = time.monotonic()
    assert bus.recv(0.05) is None
    assert 0.04 <= time.monotonic() - start < 1.0


def test_waiting_reader_receives_frame(opener):
    ours, theirs = opener(), opener()
    heard: list[can.Message | None] = []
    reader = threading.Thread(target=lambda: heard.append(theirs.recv(5.0)))
    reader.start()
    ours.send(FRAMES["standard-4"])
    reader.join(5.0)
    assert len(heard) == 1
    assert heard[0] is not None


def test_sender_handle_receives_nothing(opener, settings):
    bus, sender = opener(), open_sender(settings)
    bus.send(FRAMES["standard-8"])
    sender.send(FRAMES["standard-2"])
    assert bus.recv(2.0) is not None
    assert sender.recv(0.0) is None
    sender.shutdown()
    sender.shutdown()


def test_second_shutdown_is_harmless(opener):
    ours, theirs = opener(), opener()
    theirs.shutdown()
    theirs.shutdown()
    ours.send(FRAMES["standard-8"])  # the others go on

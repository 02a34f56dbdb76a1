"""The loopback bus beyond the transport contract: datagram format, invalid datagrams, kernel filters."""

import importlib.metadata
import os
import random
import socket

import can
import pytest
from can.typechecking import CanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.buses import loopback

TAG = loopback.channel_tag("somewhere")


@pytest.fixture
def channel(request):
    return f"{request.node.name}-{os.getpid()}"


@pytest.fixture
def bus(channel):
    with loopback.LoopbackBus(channel) as opened:
        yield opened


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (
            can.Message(arbitration_id=0x181, data=b"\x27\x06", is_extended_id=False),
            "0002000001812706",
        ),
        (can.Message(arbitration_id=0x12345, dlc=4, is_remote_frame=True), "030400012345"),
    ],
)
def test_datagram_has_the_documented_format(message, text):
    datagram = b"CANo" + TAG + bytes.fromhex(text)
    assert loopback.encode_frame(message, TAG) == datagram
    assert loopback.decode_frame(datagram, TAG).equals(message, timestamp_delta=None)
    assert loopback.decode_frame(datagram, loopback.channel_tag("another channel")) is None


_with_valid_header = st.builds(
    lambda flags, length, identifier, rest: (
        b"CANo" + TAG + bytes((flags, length)) + identifier.to_bytes(4, "big") + rest[:length]
    ),
    st.sampled_from([0, 1, 3, 4, 5]) | st.integers(0, 255),
    st.integers(0, 8) | st.integers(0, 255),
    st.integers(0, (1 << 11) - 1) | st.integers(0, (1 << 32) - 1),
    st.sampled_from([b"", bytes(range(8))]) | st.binary(max_size=80),
)


@given(st.one_of(st.binary(max_size=100), _with_valid_header))
@settings(max_examples=500, deadline=None, database=None)
def test_random_datagram_is_refused_or_a_valid_frame(datagram):
    message = loopback.decode_frame(datagram, TAG)
    if message is not None:
        message._check()  # python-can's check
        assert loopback.encode_frame(message, TAG) == datagram


def test_invalid_datagrams_are_ignored(bus, channel):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign:
        foreign.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        for datagram in (b"", b"x", b"CANo" + b"\xff" * 14, b"\x00" * 2000):
            foreign.sendto(datagram, (loopback.channel_group(channel), loopback.MULTICAST_PORT))
    with loopback.LoopbackBus(channel) as peer:
        peer.send(can.Message(arbitration_id=0x77, is_extended_id=False))
    assert bus.recv(60.0).arbitration_id == 0x77


def test_kernel_filters_agree_with_python_can(channel):
    """python-can's rule, over masks, kinds of identifier and several filters at once, is the oracle."""
    rng = random.Random(1)  # noqa: S311 - to be repeated, not to be secret
    with loopback.LoopbackBus(channel) as bus, loopback.LoopbackBus(channel) as peer:
        total = 0
        for _ in range(40):
            filters: list[CanFilter] = []
            for _ in range(rng.choice((1, 2, 12))):
                extended = rng.random() < 0.5
                mask = rng.choice((0x7FF, 0x7F8, 0x780, 0x1FFFFFFF, 0, rng.randrange(1 << 29)))
                can_filter: CanFilter = {"can_id": rng.randrange(1 << 29), "can_mask": mask}
                if rng.random() < 0.7:
                    can_filter["extended"] = extended
                    can_filter["can_id"] = rng.randrange(1 << (29 if extended else 11))
                filters.append(can_filter)
            bus.set_filters(filters)
            frames = []
            for _ in range(50):
                # The identifier of a filter, half of the time with a flipped bit.
                flipped = (1 << rng.randrange(29)) * (rng.random() < 0.5)
                identifier = rng.choice(filters)["can_id"] ^ flipped
                extended = identifier >= 1 << 11 or rng.random() < 0.3
                frames.append(can.Message(arbitration_id=identifier, is_extended_id=extended))
            for frame in frames:
                peer.send(frame)
            expected = [f.arbitration_id for f in frames if bus._matches_filters(f)]
            received = []
            # What passes the kernel, before python-can filters.
            while (message := bus._recv_internal(0.0)[0]) is not None:
                received.append(message.arbitration_id)
            assert received == expected
            total += len(received)
        assert 200 < total < 1800
        bus.set_filters(None)
        peer.send(frames[0])
        assert bus.recv(60.0) is not None


def test_datagrams_stay_on_this_machine(bus):
    sender = bus._sender
    assert sender.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
    assert sender.getsockname()[0] == "127.0.0.1"
    assert sender.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4) == bytes((127, 0, 0, 1))


def test_fd_frame_is_refused(bus):
    frame = can.Message(arbitration_id=1, is_fd=True, data=bytes(64), is_extended_id=False)
    with pytest.raises(can.CanOperationError, match="FD"):
        bus.send(frame)


def test_closed_bus_raises(channel):
    closed = loopback.LoopbackBus(channel)
    closed.shutdown()
    with pytest.raises(can.CanOperationError):
        closed.send(can.Message(arbitration_id=2, is_extended_id=False))
    with pytest.raises(can.CanOperationError):
        closed.recv(0.0)


def test_python_can_opens_it_by_interface_name(channel):
    try:
        importlib.metadata.distribution("sarcal")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("sarcal is not installed, so it has no entry points")
    with can.Bus(interface="loopback", channel=channel, ignore_config=True) as bus:
        assert isinstance(bus, loopback.LoopbackBus)

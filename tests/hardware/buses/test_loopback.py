"""The loopback bus beyond the transport contract: wire format, garbage, filters; two programs are in tests/system."""

import importlib.metadata
import itertools
import random
import socket
import threading
import time

import can
import pytest
from can.typechecking import CanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.buses import loopback
from hardware.buses.loopback import (
    LoopbackBus,
    channel_group,
    channel_tag,
    decode_frame,
    encode_frame,
)

TAG = channel_tag("somewhere")
_numbers = itertools.count()


@pytest.fixture
def channel():
    return f"loopback-test-{time.monotonic_ns()}-{next(_numbers)}"


@pytest.fixture
def bus(channel):
    with LoopbackBus(channel) as opened:
        yield opened


@st.composite
def frames(draw: st.DrawFn) -> can.Message:
    extended = draw(st.booleans())
    kind = draw(st.sampled_from(["data", "remote", "error"]))
    identifier = draw(st.integers(0, (1 << 29) - 1 if extended else (1 << 11) - 1))
    length = draw(st.sampled_from(range(9)))
    return can.Message(
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        dlc=length,
        data=None if kind == "remote" else draw(st.binary(min_size=length, max_size=length)),
        check=True,
    )


def test_the_datagram_of_a_tpdo_is_what_the_docstring_of_the_format_says():
    message = can.Message(arbitration_id=0x181, data=b"\x27\x06", is_extended_id=False)
    assert encode_frame(message, TAG) == b"CANo" + TAG + bytes.fromhex("00 02 00000181 2706")
    remote = can.Message(arbitration_id=0x12345, dlc=4, is_remote_frame=True, is_extended_id=True)
    assert encode_frame(remote, TAG) == b"CANo" + TAG + bytes.fromhex("03 04 00012345")


@given(frames())
@settings(max_examples=200, deadline=None, database=None)
def test_every_frame_survives_the_wire(message):
    arrived = decode_frame(encode_frame(message, TAG), TAG)
    assert arrived is not None
    assert arrived.equals(message, timestamp_delta=None)


_headed = st.builds(
    lambda flags, length, identifier, rest: (
        b"CANo" + TAG + bytes((flags, length)) + identifier.to_bytes(4, "big") + rest
    ),
    st.integers(0, 255),
    st.integers(0, 255),
    st.integers(0, (1 << 32) - 1),
    st.binary(max_size=80),
)


@given(st.one_of(st.binary(max_size=100), _headed))
@settings(max_examples=500, deadline=None, database=None)
def test_garbage_is_refused_or_is_a_valid_frame(datagram):
    message = decode_frame(datagram, TAG)
    if message is not None:
        message._check()  # python-can's own idea of a valid frame
        assert encode_frame(message, TAG) == datagram


def test_another_channel_of_the_same_group_is_not_heard():
    message = can.Message(arbitration_id=1, is_extended_id=False)
    assert decode_frame(encode_frame(message, channel_tag("elsewhere")), TAG) is None


def test_garbage_on_the_group_does_no_harm(bus, channel):
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with stranger:
        stranger.setsockopt(
            socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1")
        )
        for datagram in (b"", b"x", b"CANo" + b"\xff" * 14, b"\x00" * 2000):
            stranger.sendto(datagram, (channel_group(channel), loopback.MULTICAST_PORT))
    with LoopbackBus(channel) as peer:
        peer.send(can.Message(arbitration_id=0x77, is_extended_id=False))
    message = bus.recv(2.0)
    assert message is not None
    assert message.arbitration_id == 0x77


def test_frames_that_are_filtered_out_fill_nobodys_buffer(channel):
    wanted = can.Message(arbitration_id=0x181, data=b"12345678", is_extended_id=False)
    other = can.Message(arbitration_id=0x77, data=b"12345678", is_extended_id=False)
    filters = [{"can_id": 0x180, "can_mask": 0x7F8, "extended": False}]
    with LoopbackBus(channel, can_filters=filters) as bus, LoopbackBus(channel) as peer:
        for _ in range(12_000):  # more than the buffer holds
            peer.send(other)
        peer.send(wanted)
        message = bus.recv(0.0)
        assert message is not None
        assert message.arbitration_id == 0x181
        # Taken away again, everything is heard.
        bus.set_filters(None)
        peer.send(other)
        assert bus.recv(2.0) is not None


def test_the_kernel_filters_as_python_can_does(channel):
    """python-can's own rule, over masks, kinds of identifier and several filters at once, is the oracle."""
    rng = random.Random(1)  # noqa: S311 - to be repeated, not to be secret
    with LoopbackBus(channel) as bus, LoopbackBus(channel) as peer:
        seen = 0
        for _ in range(40):
            filters: list[CanFilter] = []
            for _ in range(rng.choice((1, 2, 12))):
                extended = rng.random() < 0.5
                mask = rng.choice((0x7FF, 0x7F8, 0x780, 0x1FFFFFFF, 0, rng.randrange(1 << 29)))
                wanted: CanFilter = {"can_id": rng.randrange(1 << 29), "can_mask": mask}
                if rng.random() < 0.7:
                    wanted["extended"] = extended
                    wanted["can_id"] = rng.randrange(1 << (29 if extended else 11))
                filters.append(wanted)
            bus.set_filters(filters)
            frames = []
            for _ in range(50):
                # Near to what a filter wants, or anywhere.
                near = rng.choice(filters)["can_id"] ^ (1 << rng.randrange(29)) * (
                    rng.random() < 0.5
                )
                extended = near >= 1 << 11 or rng.random() < 0.3
                frames.append(can.Message(arbitration_id=near, is_extended_id=extended))
            for frame in frames:
                peer.send(frame)
            expected = [f.arbitration_id for f in frames if bus._matches_filters(f)]
            heard = []
            # What comes through the kernel, before python-can looks.
            while (found := bus._recv_internal(0.0)[0]) is not None:
                heard.append(found.arbitration_id)
            assert heard == expected
            seen += len(heard)
        assert 200 < seen < 1800


def test_nothing_can_leave_the_machine(bus):
    sender = bus._sender
    assert sender.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
    assert sender.getsockname()[0] == "127.0.0.1"
    assert sender.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4) == bytes((127, 0, 0, 1))


def test_there_are_no_fd_frames(bus):
    frame = can.Message(arbitration_id=1, is_fd=True, data=bytes(64), is_extended_id=False)
    with pytest.raises(can.CanOperationError, match="FD"):
        bus.send(frame)


def test_the_descriptor_tells_when_there_is_something(bus, channel):
    import select

    assert select.select([bus], [], [], 0.0)[0] == []
    with LoopbackBus(channel) as peer:
        peer.send(can.Message(arbitration_id=2, is_extended_id=False))
    assert select.select([bus.fileno()], [], [], 2.0)[0] == [bus.fileno()]


def test_a_reader_that_waits_is_woken_by_others_and_not_by_itself(bus, channel):
    frame = can.Message(arbitration_id=2, is_extended_id=False)
    with LoopbackBus(channel) as peer:
        bus.send(frame)
        later = threading.Timer(0.05, peer.send, [frame])
        later.start()
        assert bus.recv(5.0) is not None
        later.join()


def test_a_closed_bus_refuses(channel):
    closed = LoopbackBus(channel)
    closed.shutdown()
    with pytest.raises(can.CanOperationError):
        closed.send(can.Message(arbitration_id=2, is_extended_id=False))
    with pytest.raises(can.CanOperationError):
        closed.recv(0.0)


def test_python_can_finds_it_by_name(channel):
    try:
        importlib.metadata.distribution("sarcal")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("sarcal is not installed, so it has no entry points")
    with can.Bus(interface="loopback", channel=channel, ignore_config=True) as bus:
        assert isinstance(bus, LoopbackBus)

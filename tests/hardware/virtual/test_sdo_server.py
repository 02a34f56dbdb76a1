"""SDO transfers: raw frames in and out of sequence, random frames, and the canopen package as a client."""

import binascii
import struct
from pathlib import Path

import can
import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hardware.eds
from hardware.virtual.sdo_server import LONGEST_DOCUMENT
from tests.oracles.virtual_rig import Rig, rig

EDS = Path(hardware.eds.__file__).parent
WRITE_2000 = struct.Struct("<BHBI")


UPLOAD_BLOCKS = struct.Struct("<BHBBB2x")


@pytest.fixture
def arm(arm):
    arm.peer.take_control()
    return arm


def exchange(arm: Rig, data: bytes, node: int = 16) -> bytes:
    arm.peer.send(0x600 + node, data)
    return arm.peer.wait_for(lambda number, _: number == 0x580 + node)[1]


def abort_code(answer: bytes) -> int | None:
    return struct.unpack_from("<I", answer, 4)[0] if answer[0] == 0x80 else None


@pytest.mark.parametrize("size", [1, 4, 5, 6, 7, 8, 13, 14, 15, 4096])
def test_document_of_any_length_is_read_back(arm, size):
    data = bytes(k * 7 % 256 for k in range(size))
    arm.peer.write(16, 0x2000, 0, data)
    assert arm.peer.read(16, 0x2000) == data


def test_download_without_length_is_accepted(arm):
    answer = exchange(arm, WRITE_2000.pack(0x20, 0x2000, 0, 0))
    assert answer == WRITE_2000.pack(0x60, 0x2000, 0, 0)
    assert exchange(arm, b"\x00" + b"abcdefg")[0] == 0x20
    assert exchange(arm, b"\x1b" + b"hi" + bytes(5))[0] == 0x30
    assert arm.peer.read(16, 0x2000) == b"abcdefghi"


@pytest.mark.parametrize(
    ("frames", "code"),
    [
        ([WRITE_2000.pack(0x21, 0x2000, 0, 8), b"\x01abcdefg"], 0x06070010),
        ([WRITE_2000.pack(0x21, 0x2000, 0, 20), b"\x00abcdefg", b"\x00abcdefg"], 0x05030000),
        ([WRITE_2000.pack(0x21, 0x2000, 0, LONGEST_DOCUMENT + 1)], 0x06070012),
        ([WRITE_2000.pack(0xC6, 0x2000, 0, LONGEST_DOCUMENT + 1)], 0x06070012),
        ([WRITE_2000.pack(0x21, 0x2004, 0, 100)], 0x06010002),
    ],
    ids=["not the announced length", "toggle", "too long", "too long in blocks", "read only"],
)
def test_invalid_download_is_aborted(arm, frames, code):
    *_, answer = (exchange(arm, frame) for frame in frames)
    assert abort_code(answer) == code
    assert answer[1:4] == frames[0][1:4]
    assert abort_code(exchange(arm, b"\x10abcdefg")) == 0x05040001
    with pytest.raises(canopen.SdoAbortedError):
        arm.peer.read(16, 0x2000)


@pytest.mark.parametrize("head", [0x00, 0x60, 0x70, 0x11, 0xA1, 0xA2, 0xA3, 0xC1, 0xE0])
def test_segment_without_transfer_is_aborted(arm, head):
    assert abort_code(exchange(arm, bytes([head]) + bytes(7))) == 0x05040001


def test_small_block_upload_switches_to_normal_upload(arm):
    answer = exchange(arm, UPLOAD_BLOCKS.pack(0xA4, 0x1000, 0, 127, 4), node=1)
    assert answer == struct.pack("<BHBI", 0x43, 0x1000, 0, 0x00020192)
    assert exchange(arm, UPLOAD_BLOCKS.pack(0xA4, 0x1000, 0, 127, 3), node=1)[0] == 0xC6


BLOCK = b"abcdefghijklmnopqr"


def begin_block_download(arm: Rig, size: int = len(BLOCK)) -> None:
    answer = exchange(arm, WRITE_2000.pack(0xC6, 0x2000, 0, size))
    assert answer == WRITE_2000.pack(0xA4, 0x2000, 0, 127)


def send_segments(arm: Rig, numbers: list[int], first: int = 1) -> bytes:
    """Send segments of `BLOCK`, counted from `first` on; return the answer to the last."""
    for number in numbers:
        part = BLOCK[7 * (number - 1) : 7 * number]
        head = number - first + 1 | (0x80 if number == 3 else 0)
        arm.peer.send(0x610, bytes([head]) + part.ljust(7, b"\0"))
    return arm.peer.wait_for(lambda n, _: n == 0x590)[1]


def test_lost_segment_is_requested_again(arm):
    begin_block_download(arm)
    assert send_segments(arm, [1, 3])[:3] == bytes([0xA2, 1, 127])
    assert send_segments(arm, [2, 3], first=2)[:3] == bytes([0xA2, 2, 127])
    assert exchange(arm, struct.pack("<BH5x", 0xC1 | 3 << 2, binascii.crc_hqx(BLOCK, 0)))[0] == 0xA1
    assert arm.peer.read(16, 0x2000) == BLOCK


@pytest.mark.parametrize(
    ("size", "crc", "last", "code"),
    [
        (18, 1, 0xC1 | 3 << 2, 0x05040004),
        (19, 0, 0xC1 | 3 << 2, 0x06070010),
        (18, 0, 0xC0 | 3 << 2, 0x05040001),
    ],
)
def test_block_download_other_than_announced_is_aborted(arm, size, crc, last, code):
    begin_block_download(arm, size)
    send_segments(arm, [1, 2, 3])
    answer = exchange(arm, struct.pack("<BH5x", last, binascii.crc_hqx(BLOCK, 0) ^ crc))
    assert abort_code(answer) == code
    assert answer[1:4] == b"\x00\x20\x00"
    with pytest.raises(canopen.SdoAbortedError):
        arm.peer.read(16, 0x2000)


def test_block_upload_resumes_after_the_last_segment_received(arm):
    arm.peer.write(16, 0x2000, 0, BLOCK)
    answer = exchange(arm, UPLOAD_BLOCKS.pack(0xA4, 0x2000, 0, 2, 0))
    assert answer == WRITE_2000.pack(0xC6, 0x2000, 0, len(BLOCK))

    def segments(frame: bytes, count: int) -> list[bytes]:
        arm.peer.send(0x610, frame.ljust(8, b"\0"))
        return [arm.peer.wait_for(lambda n, _: n == 0x590)[1] for _ in range(count)]

    assert segments(b"\xa3", 2) == [b"\x01abcdefg", b"\x02hijklmn"]
    assert segments(b"\xa2\x01\x01", 1) == [b"\x01hijklmn"]
    assert segments(b"\xa2\x01\x7f", 1) == [b"\x81opqr\0\0\0"]
    end = struct.pack("<BH5x", 0xC1 | 3 << 2, binascii.crc_hqx(BLOCK, 0))
    assert segments(b"\xa2\x01\x7f", 1) == [end]
    segments(b"\xa1", 0)
    assert abort_code(segments(b"\xa2\x01\x7f", 1)[0]) == 0x05040001


@pytest.mark.parametrize(
    ("size", "frame", "code"),
    [
        (0, b"", 0x05040002),
        (128, b"", 0x05040002),
        (2, b"\xa2\x01\x80", 0x05040002),
        (2, b"\xa2\x03\x02", 0x05040003),
        (2, b"\xa1", 0x05040001),
        (2, b"\xa3", 0x05040001),
    ],
)
def test_invalid_block_upload_is_aborted_with_its_code(arm, size, frame, code):
    arm.peer.write(16, 0x2000, 0, BLOCK)
    answer = exchange(arm, UPLOAD_BLOCKS.pack(0xA4, 0x2000, 0, size, 0))
    if frame:
        assert exchange(arm, b"\xa3".ljust(8, b"\0"))[0] == 1
        arm.peer.wait_for(lambda n, _: n == 0x590)
        answer = exchange(arm, frame.ljust(8, b"\0"))
    assert abort_code(answer) == code


def test_command_in_a_block_is_confirmed_when_it_is_done(arm):
    arm.peer.write(16, 0x2000, 0, b"SDA-0007 1 2 3 4 5 6 7")
    exchange(arm, struct.pack("<BHBI", 0xC2, 0x2002, 0, 1))
    assert exchange(arm, bytes([0x81, 1, *bytes(6)]))[:2] == b"\xa2\x01"
    assert exchange(arm, bytes([0xC1 | 6 << 2, *bytes(7)])) == b"\xa1".ljust(8, b"\0")
    assert arm.peer.unsigned(16, 0x2003, 4) == 1


@pytest.mark.parametrize("aborts", [False, True])
def test_new_request_or_abort_ends_the_previous_transfer(arm, aborts):
    exchange(arm, WRITE_2000.pack(0x21, 0x2000, 0, 20))
    if aborts:
        arm.peer.send(0x610, WRITE_2000.pack(0x80, 0x2000, 0, 0x05040000))
    else:
        assert arm.peer.unsigned(16, 0x1000) == 0
    assert abort_code(exchange(arm, b"\x00" + b"abcdefg")) == 0x05040001


def test_abandoned_command_is_not_answered_later(arm):
    arm.peer.write(16, 0x2000, 0, b"SDA-0007 1 2 3 4 5 6 7")
    arm.controller.running.clear()  # both frames are received before the command is done
    arm.peer.send(0x610, b"\x2f\x02\x20\x00\x01\x00\x00\x00")
    arm.peer.send(0x610, struct.pack("<BHB4x", 0x40, 0x1000, 0))
    arm.controller.running.set()
    answer = arm.peer.wait_for(lambda n, data: n == 0x590 and data[1:3] == b"\x00\x10")[1]
    assert answer[0] == 0x43
    assert arm.peer.unsigned(16, 0x1018, 4) == 7


@pytest.mark.parametrize("length", range(8))
def test_short_frame_gets_no_answer(arm, length):
    arm.peer.quiet()
    arm.peer.log.clear()
    arm.peer.send(0x601, bytes([0x40, 0, 0x10, 0, 0, 0, 0])[:length])
    assert arm.peer.unsigned(1, 0x1000) == 0x00020192
    assert len(arm.peer.seen(0x581)) == 1


IDENTIFIERS = (
    st.integers(0x600, 0x611)
    | st.integers(0x200, 0x210)
    | st.integers(0x700, 0x77F)
    | st.sampled_from([0x000, 0x080])
    | st.integers(0, 0x7FF)
)
DATA = st.binary(max_size=8) | st.builds(
    lambda head, index, rest: bytes([head]) + index + rest,
    st.integers(0, 255),
    st.sampled_from([b"\x00\x20\x00", b"\x02\x20\x00", b"\x10\x20\x00", b"\x03\x10\x01"]),
    st.binary(min_size=4, max_size=4),
)


FRAMES = st.lists(
    st.tuples(IDENTIFIERS, DATA, st.sampled_from([False, False, False, True])), max_size=30
)


@pytest.mark.parametrize("examples", [15, pytest.param(300, marks=pytest.mark.campaign)])
def test_random_frames_stop_neither_sdo_answers_nor_quick_stop(examples):
    settings(max_examples=examples, deadline=None)(given(FRAMES)(send_frames_then_read_and_stop))()


def send_frames_then_read_and_stop(frames: list[tuple[int, bytes, bool]]) -> None:
    """Send random data and remote frames to enabled drives, then read each node and stop each drive."""
    with rig() as arm:
        arm.plant.drift_rad = [1e-3] * 7
        arm.operational([8, 10, 10, 10, 8, 10, 10])
        for identifier, data, remote in frames:
            arm.peer.bus.send(
                can.Message(
                    arbitration_id=identifier,
                    data=None if remote else data,
                    dlc=len(data),
                    is_remote_frame=remote,
                    is_extended_id=False,
                )
            )
        arm.peer.command_all(0x02)
        arm.peer.nmt(1)
        for node in (*range(1, 8), 16):
            arm.peer.send(0x600 + node, WRITE_2000.pack(0x80, 0, 0, 0))
            arm.peer.send(0x600 + node, b"\x40\x00\x10\x00".ljust(8, b"\0"))
            arm.peer.wait_for(
                lambda n, data, node=node: n == 0x580 + node and data[:4] == b"\x43\x00\x10\x00"
            )
        arm.peer.sync()
        stopped_rad = arm.run_in_loop(lambda: list(arm.plant.angles_rad))
        for _ in range(5):
            states = arm.peer.sync()
        assert not [word for word, _, _ in states if word & 0x6F == 0x27]
        assert arm.run_in_loop(lambda: list(arm.plant.angles_rad)) == stopped_rad
        assert arm.controller.failure is None


def test_canopen_package_reads_and_writes_through_the_eds(arm):
    """Client, EDS reader and PDO decoding of the package against our server and PDOs."""
    network = canopen.Network(arm.peer.bus)
    arm.peer.start()
    network.NOTIFIER_CYCLE = 0.01
    network.connect()
    try:
        joint = canopen.RemoteNode(3, str(EDS / "joint.eds"))
        supervisor = canopen.RemoteNode(16, str(EDS / "supervisor.eds"))
        for node in (joint, supervisor):
            network.add_node(node)
            node.sdo.RESPONSE_TIMEOUT = 5.0
        assert joint.sdo[0x1000].raw == 0x00020192
        assert joint.sdo[0x1008].raw == "sarcal virtual joint drive"
        assert joint.sdo["Identity object"]["Serial number"].raw == 703
        assert supervisor.sdo[0x1000].raw == 0
        assert supervisor.sdo["Identity object"]["Serial number"].raw == 7
        assert [supervisor.sdo[0x2020][k].raw for k in (1, 2, 3)] == ["test_arm", "SDA-0007", 7]
        assert joint.sdo["Software position limit"]["Max position limit"].raw == 6000
        with pytest.raises(canopen.SdoAbortedError) as abort:
            supervisor.sdo[0x2002].raw = 2
        assert abort.value.code == 0x08000022
        assert supervisor.sdo[0x2004].raw == "nothing is staged to commit"
        # Blocks of 127 segments, with checksums.
        for size in (1, 7, 8, 889, 890, 4096):
            document = bytes(k * 7 % 256 for k in range(size))
            with supervisor.sdo[0x2000].open("wb", size=size, block_transfer=True) as block:
                block.write(document)
            with supervisor.sdo[0x2000].open("rb", block_transfer=True) as block:
                assert block.read() == document
        with joint.sdo[0x1000].open("rb", block_transfer=True) as block:
            assert block.read() == b"\x92\x01\x02\x00"
        joint.tpdo.read()
        with joint.tpdo[1].receive_condition:
            network.sync.transmit()
            joint.tpdo[1].receive_condition.wait(60.0)
        assert joint.tpdo["Position actual value"].raw == 172
        assert joint.tpdo["Statusword"].raw == 0x0250
    finally:
        network.notifier.stop()

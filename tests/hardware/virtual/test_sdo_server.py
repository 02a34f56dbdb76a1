"""SDO transfers: raw frames in and out of sequence, random frames, and the canopen package as a client."""

import re
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


@pytest.fixture
def arm(arm):
    arm.peer.take_control()
    return arm


ABC = b"abcdefg".hex()
TOO_LONG = (LONGEST_DOCUMENT + 1).to_bytes(4, "little").hex()
NO_DOCUMENT = "> 40002000 < 8000200024000008"
NO_TRANSFER = f"> 10{ABC} < 8061626301000405 {NO_DOCUMENT}"

DOWNLOADS = {
    "without a length": f"> 20002000 < 60002000 > 00{ABC} < 20 > 1b6869 < 30 "
    f"> 40002000 < 4100200009 > 60 < 00{ABC} > 70 < 1b6869",
    "not the announced length": f"> 2100200008 < 60002000 > 01{ABC} < 8000200010000706 {NO_TRANSFER}",
    "toggle": f"> 2100200014 < 60002000 > 00{ABC} < 20 > 00{ABC} < 8000200000000305 {NO_TRANSFER}",
    "too long": f"> 21002000{TOO_LONG} < 8000200012000706 {NO_TRANSFER}",
    "read only": f"> 2104200064 < 8004200002000106 {NO_TRANSFER}",
    "ended by a request": f"> 2100200014 < 60002000 > 40001000 < 43001000 {NO_TRANSFER}",
    "ended by an abort": f"> 2100200014 < 60002000 > 8000200000000405 {NO_TRANSFER}",
    "blocks": f"> c600200012 < 8000200001000405 {NO_DOCUMENT}",
    "blocks to be read": "> a40010007f00 < 8000100001000405",
    **{
        f"segment {head} without a transfer": f"> {head} < 8000000001000405"
        for head in ("00", "60", "70", "11", "a1", "a2", "a3", "c1", "e0")
    },
}


def play(arm: Rig, frames: str) -> None:
    """Send the frames after `>` to node 16, and compare its answers with those after `<`; their ends are zeros."""
    for direction, text in re.findall("([<>]) ([0-9a-f]+)", frames):
        data = bytes.fromhex(text).ljust(8, b"\0")
        if direction == ">":
            arm.peer.send(0x610, data)
        else:
            assert arm.peer.wait_for(lambda number, _: number == 0x590)[1] == data, text


@pytest.mark.parametrize("name", DOWNLOADS)
def test_download_has_the_answers_of_the_standard(arm, name):
    play(arm, DOWNLOADS[name])


@pytest.mark.parametrize("size", [1, 4, 5, 6, 7, 8, 13, 14, 15, 4096])
def test_document_of_any_length_is_read_back(arm, size):
    data = bytes(k * 7 % 256 for k in range(size))
    arm.peer.write(16, 0x2000, 0, data)
    assert arm.peer.read(16, 0x2000) == data


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
            arm.peer.send(0x600 + node, b"\x80" + bytes(7))
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
        for size in (1, 7, 8, 889, 890, 4096):
            document = bytes(k * 7 % 256 for k in range(size))
            with supervisor.sdo[0x2000].open("wb", size=size) as segments:
                segments.write(document)
            with supervisor.sdo[0x2000].open("rb") as segments:
                assert segments.read() == document
        joint.tpdo.read()
        with joint.tpdo[1].receive_condition:
            network.sync.transmit()
            joint.tpdo[1].receive_condition.wait(60.0)
        assert joint.tpdo["Position actual value"].raw == 172
        assert joint.tpdo["Statusword"].raw == 0x0250
    finally:
        network.notifier.stop()

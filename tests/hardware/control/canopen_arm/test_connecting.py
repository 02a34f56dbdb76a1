"""Connecting to an arm on a fake bus: identity, other masters, missing nodes, lost frames, recordings."""

import itertools
import re
import threading
from collections.abc import Callable

import can
import pytest

from hardware import errors
from hardware.arm import DriveState
from hardware.canopen.sdo import ObjectAccess
from tests.hardware.control.canopen_arm.conftest import PER_RAD, make, short_timing
from tests.hardware.fake_arm import JOINTS, FakeArmBus, FrameLoss

NODES = [*range(1, 8), 16]


def test_connect_resets_starts_and_identifies_nodes_of_the_arm(arm, bus):
    nmt = [data for identifier, data in bus.sent if identifier == 0x000]
    assert nmt == [bytes([command, node]) for command in (0x82, 0x01) for node in NODES]
    arm.close()
    identity = arm.connect()
    assert (identity.model, identity.serial_number) == ("fake", "FAKE-1")
    assert [node.node for node in identity.nodes] == NODES
    assert identity.nodes[-1].role == "supervisor"
    assert identity.nodes[2].serial_number == 7003
    snapshot = arm.snapshot()
    assert [j.position_counts for j in snapshot.joints] == [d.counts for d in bus.drives.values()]
    assert snapshot.joints[0].position_rad == pytest.approx(1000 / PER_RAD)
    assert snapshot.joints[0].drive is DriveState.SWITCH_ON_DISABLED
    assert snapshot.token == 0
    assert set(snapshot.heartbeat_age_s) == {*NODES}


def test_operator_heartbeat_prevents_any_transmission(bus):
    bus.other_master = ((0x77F, b"\x05"),)
    with pytest.raises(errors.ControlDenied) as denied:
        make(bus).connect()
    assert denied.value.holder == 127
    assert "another program" in str(denied.value), "node 127 is this program's number too"
    assert bus.sent == []


COMMAND_TO_JOINT_1 = 0x201, bytes.fromhex("0f000500000008")


def test_traffic_of_another_master_prevents_any_transmission(bus):
    bus.other_master = ((0x080, b""), COMMAND_TO_JOINT_1)
    expected = r"uses this bus: it sent a SYNC \(COB-ID 080h\).* End that program"
    with pytest.raises(errors.OtherMaster, match=expected):
        make(bus, timing=short_timing(listen_s=0.3)).connect()
    assert bus.sent == []


def test_frames_received_before_listening_are_ignored(connected, bus):
    """An adapter may hold the last frames of a predecessor that was killed."""
    for frame in ((0x080, b""), COMMAND_TO_JOINT_1, (0x000, b"\x82\x00")):
        bus.inject(*frame)
    connected()


def test_nmt_command_while_connecting_raises_other_master(bus):
    def interfere(identifier: int, data: bytes) -> None:
        if (identifier, data) == (0x000, b"\x82\x07"):
            bus.inject(0x000, b"\x80\x00")

    bus.on_send = interfere
    with pytest.raises(
        errors.OtherMaster,
        match=r"commands this arm: it sent the NMT command 'enter pre-operational' to all nodes \(COB-ID 000h\)",
    ):
        make(bus).connect()


def test_missing_nodes_fail_connecting_and_leave_no_thread(bus):
    bus.offline = {3, 16}
    before = threading.active_count()
    with pytest.raises(errors.NodeMissing) as missing:
        make(bus).connect()
    assert missing.value.nodes == (3, 16)
    assert bus.sent.count((0x000, b"\x82\x03")) == 1, "a silent node is not reset again"
    assert threading.active_count() == before


@pytest.mark.parametrize("defect", ["without_heartbeat", "never_starts"])
def test_node_that_does_not_start_is_not_called_missing(bus, defect, approve):
    """It has booted and answers by SDO."""
    setattr(bus, defect, {2})
    with pytest.raises(errors.NodeNotStarted) as refused:
        make(bus).connect()
    assert (list(refused.value.nodes), bus.commands) == ([2], [])
    approve(str(refused.value))


def test_bus_failure_during_boot_ends_connecting(bus):
    def break_adapter(identifier: int, data: bytes) -> None:
        if (identifier, data) == (0x000, b"\x82\x10"):
            bus.io_error = can.CanOperationError("adapter gone")

    bus.on_send = break_adapter
    with pytest.raises(errors.BusError, match="can no longer be read: adapter gone"):
        make(bus).connect()


SHORT_SDO_TIMEOUT = short_timing(sdo_timeout_s=0.15)


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
    with pytest.raises(errors.FramesLost, match=r"\d of \d+ requests to node 1") as lost:
        make(bus, timing=SHORT_SDO_TIMEOUT).connect()
    unanswered, sent = map(sum, zip(*lost.value.requests.values(), strict=True))
    assert unanswered == 8
    assert sent <= requests(bus) < 60, "of more than 500"


def test_one_percent_frame_loss_is_tolerated(connected, bus):
    bus.drops = one_in(100)
    connected(timing=SHORT_SDO_TIMEOUT)
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
        with pytest.raises(errors.BusError):
            access.read_once(node, 0x6041)
    assert [access.read_unsigned(node, 0x1000) for node in (*nodes, *nodes)] == [7] * 16
    assert not lost


def test_single_unanswered_object_is_no_frame_loss(bus):
    bus.drops = lambda identifier, data: (identifier, data[1:3]) == (0x604, b"\x14\x10")
    with pytest.raises(
        errors.BusError, match="Node 4 does not answer when asked for 1014h"
    ) as silent:
        make(bus, timing=SHORT_SDO_TIMEOUT).connect()
    assert not isinstance(silent.value, errors.FramesLost)
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


def test_recording_holds_every_frame_in_order(connected, bus, tmp_path):
    arm = connected(record_to=tmp_path / "bus.blf")
    arm.take_control()
    arm.stop()
    arm.close()
    assert arm.recording_failure is None
    frames = list(can.LogReader(tmp_path / "bus.blf"))
    directions = [(frame.arbitration_id, frame.is_rx) for frame in frames]
    assert directions.count((0x080, False)) == bus.syncs
    # The bus may be closed before the answer to the last SYNC.
    assert bus.syncs - directions.count((0x183, True)) in (0, 1)
    stops = [f for f in frames if 0x200 < f.arbitration_id <= 0x207 and f.data[:2] == b"\x02\x00"]
    assert {f.arbitration_id for f in stops} == {0x201 + k for k in range(JOINTS)}
    assert not any(f.is_rx for f in stops)
    open_requests = 0
    for frame in sorted(frames, key=lambda f: f.timestamp):
        open_requests += frame.arbitration_id == 0x604
        if frame.arbitration_id == 0x584:
            assert open_requests > 0
            open_requests -= 1


def test_reconnecting_starts_a_second_recording(connected, tmp_path):
    arm = connected(record_to=tmp_path / "bus.blf")
    arm.close()
    first = (tmp_path / "bus.blf").read_bytes()
    arm.connect()
    arm.close()
    assert (tmp_path / "bus.blf").read_bytes() == first
    with can.LogReader(tmp_path / "bus-2.blf") as second:
        assert any(frame.arbitration_id == 0x701 for frame in second)


def test_unwritable_recording_raises_bus_error(connected, tmp_path):
    with pytest.raises(errors.BusError, match="cannot be recorded"):
        connected(record_to=tmp_path / "missing" / "bus.blf")

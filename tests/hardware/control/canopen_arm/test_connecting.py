"""Connecting to an arm on a fake bus: identity, other masters, missing nodes."""

import threading

import can
import pytest

from hardware.arm import DriveState
from hardware.errors import (
    BusError,
    ControlDenied,
    NodeMissing,
    NodeNotStarted,
    OtherMaster,
)
from tests.hardware.control.canopen_arm.conftest import PER_RAD, make, short_timing
from tests.hardware.fake_arm import FakeArmBus

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
    with pytest.raises(ControlDenied) as denied:
        make(bus).connect()
    assert denied.value.holder == 127
    assert "another program" in str(denied.value), "node 127 is this program's number too"
    assert bus.sent == []


COMMAND_TO_JOINT_1 = 0x201, bytes.fromhex("0f000500000008")


def test_traffic_of_another_master_prevents_any_transmission(bus):
    bus.other_master = ((0x080, b""), COMMAND_TO_JOINT_1)
    expected = r"uses this bus: it sent a SYNC \(COB-ID 080h\).* End that program"
    with pytest.raises(OtherMaster, match=expected):
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
        OtherMaster,
        match=r"commands this arm: it sent the NMT command 'enter pre-operational' to all nodes \(COB-ID 000h\)",
    ):
        make(bus).connect()


def test_missing_nodes_fail_connecting_and_leave_no_thread(bus):
    bus.offline = {3, 16}
    before = threading.active_count()
    with pytest.raises(NodeMissing) as missing:
        make(bus).connect()
    assert missing.value.nodes == (3, 16)
    assert bus.sent.count((0x000, b"\x82\x03")) == 1, "a silent node is not reset again"
    assert threading.active_count() == before


@pytest.mark.parametrize("defect", ["without_heartbeat", "never_starts"])
def test_node_that_does_not_start_is_not_called_missing(bus, defect, approve):
    """It has booted and answers by SDO."""
    setattr(bus, defect, {2})
    with pytest.raises(NodeNotStarted) as refused:
        make(bus).connect()
    assert list(refused.value.nodes) == [2]
    assert bus.commands == []
    approve(str(refused.value))


def test_bus_failure_during_boot_ends_connecting():
    class Breaking(FakeArmBus):
        """Cannot be read after the reset of the first node."""

        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            if (0x000, b"\x82\x01") in self.sent:
                raise can.CanOperationError("adapter gone")
            return super()._recv_internal(timeout)

    with pytest.raises(BusError, match="can no longer be read: adapter gone"):
        make(Breaking()).connect()

"""Unexpected traffic on a fake bus is reported."""

import itertools
import struct
import time
from contextlib import suppress

import can
import pytest

from hardware import errors
from hardware.control.control_loop import MAX_IDLE_POLL_S
from hardware.monitors.node_monitor import NodeMonitor
from hardware.timing import Timing
from tests.hardware.control.canopen_arm.conftest import short_timing, wait_for
from tests.hardware.fake_arm import JOINTS, FakeArmBus, capture_for_ever
from tests.oracles.profiles import sarcos


@pytest.mark.parametrize(
    "frame",
    [
        (0x203, struct.pack("<Hib", 0x0F, 5, 8)),
        (0x080, b""),
        (0x000, b"\x02\x03"),
        (0x610, bytes.fromhex("2100200000010000")),
        (0x610, bytes.fromhex("c600200000010000")),
        (0x603, bytes.fromhex("c07d600108000000")),
    ],
)
def test_command_of_another_program_raises_other_master(driven, bus, frame, approve):
    bus.inject(*frame)
    with pytest.raises(errors.OtherMaster) as refused:
        capture_for_ever(driven)
    approve(str(refused.value))
    driven.hold()
    driven.reset_stop()  # does not undo what that program changed
    with pytest.raises(errors.OtherMaster):
        driven.take_control()


def test_other_master_alarm_precedes_stopped_node_alarm(driven, bus):
    bus.inject(0x703, b"\x7f")
    bus.inject(0x000, b"\x80\x00")
    with pytest.raises(errors.OtherMaster, match="'enter pre-operational' to all nodes"):
        capture_for_ever(driven)


def test_reads_and_quick_stops_of_another_program_are_allowed(driven, bus):
    bus.inject(0x610, bytes.fromhex("4000200000000000"))
    bus.inject(0x610, bytes.fromhex("a400200020000000"))  # a block upload
    bus.inject(0x203, struct.pack("<Hib", 0x02, 0, 8))
    driven.capture(20)


@pytest.mark.parametrize("joint", [1, 4, 7])
def test_two_tpdos_per_sync_raise_duplicate_node_id(driven, bus, joint):
    bus.doubling_tpdo = {joint}
    with pytest.raises(errors.DuplicateNodeId, match=f"two devices answer as node {joint}"):
        driven.capture(50)


@pytest.mark.campaign
def test_capture_with_few_complete_samples_fails(driven, bus):
    def silence_one_joint(sync: int) -> None:
        bus.without_tpdo = {1 + sync % JOINTS}

    bus.on_sync = silence_one_joint
    with pytest.raises(errors.BusError, match="Hardly any SYNC is answered"):
        driven.capture(1)


@pytest.mark.parametrize("node", [1, 7])
def test_duplicate_sdo_responses_raise_duplicate_node_id(driven, bus, node):
    bus.duplicates_response = {node}.__contains__
    # The second response of the node that is read last may come after the first `hold`.
    with suppress(errors.DuplicateNodeId):
        driven.hold()
    with pytest.raises(errors.DuplicateNodeId, match=f"two devices answer as node {node}"):
        driven.hold()


@pytest.mark.parametrize("nodes", [{7}, set(range(1, JOINTS + 1)) | {16}])
def test_sdo_requests_of_another_program_are_not_a_duplicate_node(driven, bus, nodes):
    """The responses to a maker's polling tool look like second responses."""

    def polled(node: int) -> bool:
        if node in nodes:
            bus.inject(0x600 + node, bytes.fromhex("4041600000000000"))
        return node in nodes

    bus.duplicates_response = polled
    with suppress(errors.DuplicateNodeId):
        driven.hold()
    with pytest.raises(
        errors.DuplicateNodeId, match=r"another program sends SDO requests to node .*7"
    ):
        driven.hold()


def test_occasional_duplicate_sdo_response_is_no_duplicate_node(driven, bus):
    responses = itertools.count()
    bus.duplicates_response = lambda node: node == 4 and next(responses) % 2 == 0
    for _ in range(10):
        driven.hold()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {(4, 0x1A00, 2): struct.pack("<L", 0x606C0020)},
            "node 4, 1A00h: expected TPDO1 = .*606Ch",
        ),
        ({}, "node 4, 6064h: expected 5000 counts, as read by SDO, found 4000 counts in TPDO1"),
    ],
)
def test_changed_tpdo_mapping_ends_capture(driven, bus, changed, words):
    driven.capture(3)
    bus.objects |= {**changed, (4, 0x6064, 0): struct.pack("<l", 5000)}
    with pytest.raises(
        errors.MappingChanged, match=f"the set-up of these nodes was changed.*{words}"
    ):
        driven.capture(3)


def test_interrupted_move_reports_changed_mapping(driven, bus):
    bus.objects[4, 0x6064, 0] = struct.pack("<l", 5000)
    with pytest.raises(errors.MappingChanged, match="node 4, 6064h"):
        driven.move({2: 0.3}, speed_rad_per_s=0.5, watch=lambda _: "joint 4 does not follow")


def test_noise_or_unreadable_position_is_no_changed_mapping(driven, bus):
    bus.drives[4].noise = lambda sync: 1000 * (sync * sync % 7 == 1)
    assert driven.capture(3).samples == 3
    bus.objects[1, 0x6064, 0] = 0x08000000
    assert driven.capture(3).samples == 3


def test_slow_producer_extends_heartbeat_timeout(connected, bus):
    bus.objects |= {(node, 0x1017, 0): struct.pack("<H", 800) for node in bus.drives}
    arm = connected()
    bus.without_heartbeat = {3}
    until_s = time.monotonic() + 0.6
    while time.monotonic() < until_s:  # 0.35 s for drives without 1017h
        arm.capture(1)


def test_sdo_timeout_is_configurable(connected, bus):
    arm = connected(timing=short_timing(sdo_timeout_s=0.05))
    bus.offline = {3}

    def attempt_s() -> float:
        begun_s = time.monotonic()
        with pytest.raises(errors.BusError, match="Node 3 does not answer"):
            arm.access.read_unsigned(3, 0x6065)
        return time.monotonic() - begun_s

    # The shortest, as the computer may be busy.
    assert min(attempt_s() for _ in range(3)) < 2.9, "three times the default of 1 s"


def test_position_jump_raises_sensor_fault(driven, bus):
    driven.capture(20)
    bus.drives[3].counts += 500
    with pytest.raises(errors.SensorFault, match=r"joint 3 jumped by \+500 counts") as fault:
        driven.capture(50)
    assert fault.value.joint == 3
    with pytest.raises(errors.SensorFault):
        driven.capture(1)
    driven.hold()
    driven.reset_stop()


def test_refused_control_gives_the_supervisors_reason(arm, bus):
    bus.denies_control, bus.refusal = True, "the heartbeat of node 127 is not heard"
    with pytest.raises(errors.ControlDenied, match="refused: the heartbeat of node 127") as denied:
        arm.take_control()
    assert "node 0" not in str(denied.value)


def test_idle_loop_polls_less_often_until_next_task(connected):
    class TimedBus(FakeArmBus):
        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            waits_s.append(timeout or 0.0)
            return super()._recv_internal(timeout)

    waits_s: list[float] = []
    timing = Timing()
    arm = connected(TimedBus(), timing=timing)
    arm.take_control()
    waits_s.clear()
    wait_for(lambda: waits_s[-1:] == [MAX_IDLE_POLL_S])
    waits_s.clear()
    arm.capture(2)
    wait_for(lambda: waits_s[-1:] == [MAX_IDLE_POLL_S])
    assert timing.idle_poll_s in waits_s, "the next task may follow at once"


def test_repeated_emergency_is_one_fault():
    nodes = NodeMonitor(sarcos(7))
    for sync in range(5000):
        for code in (0x8311, 0x7305):
            nodes.note(0x84, struct.pack("<HB5x", code, 0x21), sync)
    nodes.note(0x84, struct.pack("<HB5x", 0, 0x21), 5000)  # an error ended, others remain
    assert [(fault.node, fault.code, fault.sync_count) for fault in nodes.faults] == [
        (4, 0x8311, 0),
        (4, 0x7305, 0),
    ]
    nodes.note(0x84, bytes(8), 5001)
    assert nodes.faults == ()

"""The probe lists the nodes of a bus; it only reads, and sends nothing on a bus in use."""

import struct
from dataclasses import replace
from unittest.mock import Mock

import pytest

from hardware.buses.shared_bus import SharedBus
from hardware.commissioning.probe import ObjectAccess, Probe, probe
from hardware.errors import BusError
from tests.hardware.fake_arm import FakeArmBus
from tests.oracles.profiles import sarcos


@pytest.fixture
def bus(monkeypatch):
    monkeypatch.setattr("hardware.commissioning.probe.LISTEN_PERIODS", 0.3)
    bus = FakeArmBus()
    yield bus
    # SDO reads only: no NMT, no SYNC, no command.
    assert {identifier & ~0x7F for identifier, _ in bus.sent} <= {0x600}
    assert {data[0] for _, data in bus.sent} <= {0x40, 0x60, 0x70, 0x80}


def probe_of(bus: FakeArmBus, slowest_ms: int = 50) -> Probe:
    profile = replace(sarcos(), slowest_heartbeat_ms=slowest_ms, sdo_timeout_s=0.1)
    return probe(SharedBus(bus), profile)


def test_probe_lists_every_node_with_type_and_position(bus):
    result = probe_of(bus)
    assert result.busy == ""
    assert result.heard == tuple(node.node for node in result.nodes) == (*range(1, 8), 16)
    assert [node.drive for node in result.nodes] == [True] * 7 + [False]
    assert [node.position_counts for node in result.nodes] == [*range(1000, 6001, 1000), 100, None]
    assert [node.serial_number - 7000 for node in result.nodes] == [*range(1, 8), 16]
    assert [node.problems for node in result.nodes] == [()] * 8


@pytest.mark.parametrize(
    ("attribute", "value", "words"),
    [
        ("objects", {(3, 0x1A00, 2): struct.pack("<L", 0x606C0020)}, ("1A00h", "606Ch(32)")),
        ("duplicates_response", {3}.__contains__, ("two devices answer as node 3",)),
        ("without_heartbeat", {3}, ("no heartbeat was heard in 0.3 s",)),
    ],
)
def test_probe_reports_problem_of_one_node(bus, attribute, value, words):
    setattr(bus, attribute, value)
    problems = {node.node: node.problems for node in probe_of(bus).nodes}
    (problem,) = problems.pop(3)
    assert all(part in problem for part in ("node 3", *words))
    assert set(problems.values()) == {()}


def test_probe_listens_for_the_slowest_heartbeat(bus):
    bus.without_heartbeat = {3}
    assert "heard in 0.6 s" in probe_of(bus, slowest_ms=2000).nodes[2].problems[0]


def test_probe_lists_heard_nodes_that_do_not_answer_in_time(bus, monkeypatch):
    access = Mock(wraps=ObjectAccess)
    monkeypatch.setattr("hardware.commissioning.probe.ObjectAccess", access)
    bus.drops = lambda identifier, _data: identifier == 0x603
    (unanswering,) = probe_of(bus).unanswering
    assert unanswering.startswith("node 3 sends a heartbeat, but answers no SDO request: reset")
    assert access.call_args.kwargs == {"timeout_s": 0.1}


def test_probe_checks_heartbeat_consumers(bus):
    for node, time_ms in ((1, 500), (2, 0), (4, 500)):
        bus.set_heartbeat_consumers(node, (127, time_ms))
    bus.objects[4, 0x6007, 0] = bytes(2)
    nodes = {node.node: node for node in probe_of(bus).nodes}
    assert nodes[1].notes == nodes[16].notes == ()
    assert nodes[1].problems == nodes[3].problems == nodes[4].problems == ()
    assert nodes[4].notes[0].startswith("node 4 takes no action after a heartbeat time-out (6007h")
    words = "node 2, 1016h: expected a time-out of at most 10000 ms for the heartbeat of node 127"
    assert words in nodes[2].problems[0]
    assert nodes[3].notes[0].startswith("node 3 has no 1016h")


@pytest.mark.parametrize(
    ("identifier", "data", "words"),
    [
        (0x77F, "05", "the heartbeat of an operator, node 127 (COB-ID 77Fh)"),
        (0x080, "", "a SYNC (COB-ID 080h)"),
        (0x080, "07", "a SYNC (COB-ID 080h)"),
        (0x000, "0100", "the NMT command 'start' to all nodes (COB-ID 000h)"),
        (0x000, "8203", "the NMT command 'reset communication' to node 3 (COB-ID 000h)"),
        (0x000, "", "an NMT command (COB-ID 000h)"),
        (0x603, "4064600000000000", "a read of 6064h of node 3 (COB-ID 603h)"),
        (0x62A, "2b4060000f000000", "a write to 6040h of node 42 (COB-ID 62Ah)"),
        (0x603, "a006100000000000", "a read of 1006h of node 3 (COB-ID 603h)"),
        (0x603, "c206100000000000", "a write to 1006h of node 3 (COB-ID 603h)"),
        (0x603, "6000000000000000", "an SDO transfer with node 3 (COB-ID 603h)"),
        (0x205, "0f000000000008", "a command to joint 5 (COB-ID 205h)"),
        (0x30C, "00", "a command to node 12, RPDO2 (COB-ID 30Ch)"),
    ],
)
def test_probe_of_bus_with_other_master_sends_nothing(bus, identifier, data, words):
    for _ in range(2):
        bus.inject(identifier, bytes.fromhex(data))
    result = probe_of(bus)
    assert result.busy == f"another program uses this bus: {words}, 2 times"
    assert (127 in result.heard, bus.sent) == (identifier == 0x77F, [])


@pytest.mark.parametrize("identifier", [0x081, 0x100, 0x185, 0x283, 0x586, 0x703, 0x7E4])
def test_node_initiated_frames_do_not_make_bus_busy(bus, identifier):
    bus.inject(identifier, bytes(8))
    result = probe_of(bus)
    assert (result.busy, result.meanwhile, len(result.nodes)) == ("", "", 8)


def test_master_starting_during_probe_is_reported(bus):
    def interfere(identifier: int, _data: bytes) -> None:
        if identifier == 0x601:
            bus.inject(0x608, bytes.fromhex("4064600000000000"))

    bus.on_send = interfere
    result = probe_of(bus)
    assert len(result.nodes) == 8
    words = "started to use this bus during the probe: a read of 6064h of node 8 (COB-ID 608h)"
    assert words in result.meanwhile


def test_busy_message_is_limited_to_six_frame_kinds(bus):
    for node in range(1, 10):
        bus.inject(0x600 + node, bytes.fromhex("4064600000000000"))
    assert probe_of(bus).busy.endswith("of node 6 (COB-ID 606h); and 3 more")


def test_probe_of_empty_bus_lists_no_nodes_and_a_failed_adapter_is_named(bus):
    bus.offline = {*range(1, 8), 16}
    assert probe_of(bus) == Probe(busy="", heard=(), nodes=())
    bus.recv = Mock(side_effect=OSError("adapter gone"))
    with pytest.raises(BusError, match="adapter gone"):
        probe_of(bus)

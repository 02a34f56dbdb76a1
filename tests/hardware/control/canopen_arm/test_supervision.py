"""Heartbeat and following-error settings of the drives, checked before anything is enabled."""

import math
import struct

import pytest

from hardware.arm_description import JointScale
from hardware.canopen.drive_settings import following_windows_counts
from hardware.canopen.sdo import ObjectAccess
from hardware.errors import MappingMismatch
from tests.hardware.fake_arm import FakeArmBus
from tests.hardware.on_fake_bus import make
from tests.oracles.profiles import sarcos

OPERATOR = 127
COUNTS_PER_DEGREE = 400_000 / 360


def set_heartbeat_consumers(bus: FakeArmBus, node: int, *entries: tuple[int, int]) -> None:
    """Set 1016h of a drive: producer nodes and time-outs, ms."""
    bus.objects[node, 0x1016, 0] = bytes([len(entries)])
    for sub, (producer, time_ms) in enumerate(entries, 1):
        bus.objects[node, 0x1016, sub] = struct.pack("<L", producer << 16 | time_ms)


def connection_refusal(bus: FakeArmBus) -> MappingMismatch:
    """Connect; return the error, which comes before any command."""
    with pytest.raises(MappingMismatch) as refused:
        make(bus).connect()
    assert bus.commands == []
    return refused.value


@pytest.mark.parametrize(
    "entries",
    [
        [],
        [(0, 0)],
        [(OPERATOR, 0)],
        [(OPERATOR, 10_001)],
        [(OPERATOR - 1, 500)],
        [(5, 500), (OPERATOR, 0)],
    ],
)
def test_drive_without_operator_heartbeat_timeout_is_refused(bus, entries):
    set_heartbeat_consumers(bus, 6, *entries)
    expected = "node 6, 1016h: expected a time-out of at most 10000 ms"
    assert expected in str(connection_refusal(bus))


@pytest.mark.parametrize(
    "entries", [[(OPERATOR, 1)], [(OPERATOR, 10_000)], [(5, 0), (OPERATOR, 500)]]
)
def test_one_valid_heartbeat_consumer_entry_is_accepted(connected, bus, entries):
    set_heartbeat_consumers(bus, 6, *entries)
    connected()


def test_drives_without_heartbeat_consumer_are_listed(bus):
    for node in (1, 2, 4, 6, 7):
        set_heartbeat_consumers(bus, node, (OPERATOR, 500))
    arm = make(bus)
    assert arm.connect().unwatching == (3, 5)
    arm.close()


@pytest.mark.parametrize(("option", "listed"), [(0, True), (1, False), (3, False), (-1, False)])
def test_drive_without_reaction_to_the_timeout_is_listed(bus, option, listed):
    for node in range(1, 8):
        set_heartbeat_consumers(bus, node, (OPERATOR, 500))
    bus.objects[4, 0x6007, 0] = struct.pack("<h", option)
    arm = make(bus)
    assert arm.connect().unwatching == ((4,) if listed else ())
    assert [drive.ignores_timeout for drive in arm.drive_facts()] == [
        listed and joint == 4 for joint in range(1, 8)
    ]
    arm.close()


class Windows(ObjectAccess):
    """Nodes with these values of 6065h."""

    def __init__(self, *counts: int) -> None:
        self._counts = counts

    def read(self, node: int, index: int, subindex: int = 0) -> bytes:
        assert (index, subindex) == (0x6065, 0)
        return struct.pack("<L", self._counts[node - 1])


def test_following_window_is_a_third_of_6065h_or_one_degree():
    limits = {
        3000: 1000.0,
        0: COUNTS_PER_DEGREE,
        0xFFFFFFFF: COUNTS_PER_DEGREE,
        1: 10.0,
        29: 10.0,
        400_000: COUNTS_PER_DEGREE,
        0x7FFFFFFF: COUNTS_PER_DEGREE,
        0xFFFFFFFE: COUNTS_PER_DEGREE,
    }
    counts_per_rad = 360 * COUNTS_PER_DEGREE / math.tau
    scales = [JointScale(counts_per_rad=(-1) ** k * counts_per_rad) for k in range(len(limits))]
    windows = following_windows_counts(Windows(*limits), sarcos(len(limits)), scales)
    assert windows == pytest.approx([*limits.values()])


@pytest.mark.parametrize(
    ("period_ms", "profile_may_accept"), [(5000, True), (10_001, False), (0, False)]
)
def test_slow_heartbeat_names_its_remedies(bus, period_ms, profile_may_accept):
    bus.objects[3, 0x1017, 0] = struct.pack("<H", period_ms)
    message = str(connection_refusal(bus))
    assert "node 3, 1017h sub 0" in message
    assert "Set 1017h in these drives as expected, with their maker's tool" in message
    assert ("heartbeat: slowest_ms" in message) is profile_may_accept
    assert ("no bus profile can accept another value" in message) is not profile_may_accept
    assert "probe --draft" not in message


def test_each_difference_has_its_own_remedy(bus):
    bus.objects[3, 0x1005, 0] = struct.pack("<L", 0x81)
    bus.objects[4, 0x1A00, 2] = struct.pack("<L", 0x606C0020)
    message = str(connection_refusal(bus))
    assert "Set 1005h in these drives as expected, with their maker's tool" in message
    assert "commission them as expected, or describe them in a bus profile" in message


@pytest.mark.parametrize(
    ("index", "form", "value"), [(0x6071, "<h", -50), (0x60B2, "<h", 200), (0x60B0, "<l", 4000)]
)
def test_nonzero_torque_or_offset_is_refused(bus, index, form, value):
    bus.objects[3, index, 0] = struct.pack(form, value)
    refusal = connection_refusal(bus)
    assert refusal.differences == (f"node 3, {index:04X}h: expected 0, found {value}",)
    message = str(refusal)
    for remedy in (
        f"Set {index:04X}h in these drives as expected, with their maker's tool",
        "send it as 0 with the commands, or write 0 (pdo_maps: configured), then connect",
    ):
        assert remedy in message
    for wrong in ("probe --draft", "no bus profile can accept another value"):
        assert wrong not in message

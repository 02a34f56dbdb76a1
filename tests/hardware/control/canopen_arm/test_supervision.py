"""Who watches whom as the nodes are set up, and what was left in them: refused before anything is enabled."""

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
DEGREE = 400_000 / 360
"""Of a joint, counts."""


def watches(bus: FakeArmBus, node: int, *entries: tuple[int, int]) -> None:
    """Give a drive its 1016h: nodes and milliseconds."""
    bus.objects[node, 0x1016, 0] = bytes([len(entries)])
    for sub, (watched, time_ms) in enumerate(entries, 1):
        bus.objects[node, 0x1016, sub] = struct.pack("<L", watched << 16 | time_ms)


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
    watches(bus, 6, *entries)
    with pytest.raises(
        MappingMismatch, match="node 6, 1016h: expected a time-out of at most 10000 ms"
    ):
        make(bus).connect()
    assert not [identifier for identifier, _ in bus.sent if 0x200 < identifier <= 0x207]


@pytest.mark.parametrize(
    "entries", [[(OPERATOR, 1)], [(OPERATOR, 10_000)], [(5, 0), (OPERATOR, 500)]]
)
def test_one_valid_heartbeat_consumer_entry_is_accepted(connected, bus, entries):
    watches(bus, 6, *entries)
    connected()


def test_drives_without_heartbeat_consumer_are_listed(bus):
    for node in (1, 2, 4, 6, 7):
        watches(bus, node, (OPERATOR, 500))
    arm = make(bus)
    assert arm.connect().unwatching == (3, 5)
    arm.close()


class Windows(ObjectAccess):
    """Nodes that answer 6065h with what they are given."""

    def __init__(self, *counts: int) -> None:
        self._counts = counts

    def read(self, node: int, index: int, subindex: int = 0) -> bytes:
        assert (index, subindex) == (0x6065, 0)
        return struct.pack("<L", self._counts[node - 1])


def test_following_window_is_a_third_of_6065h_or_one_degree():
    scales = [JointScale(counts_per_rad=sense * 360 * DEGREE / math.tau) for sense in (1, -1, 1)]
    windows = following_windows_counts(Windows(3000, 0, 0xFFFFFFFF), sarcos(3), scales)
    assert windows == pytest.approx([1000.0, DEGREE, DEGREE])


@pytest.mark.parametrize(
    ("told", "window"),
    [(1, 10.0), (29, 10.0), *((told, DEGREE) for told in (400_000, 0x7FFFFFFF, 0xFFFFFFFE))],
)
def test_following_window_is_bounded(told, window):
    scale = JointScale(counts_per_rad=360 * DEGREE / (2 * math.pi))
    found = following_windows_counts(Windows(told), sarcos(1), [scale])
    assert found == pytest.approx([window])


@pytest.mark.parametrize(("period_ms", "sayable"), [(5000, True), (10_001, False), (0, False)])
def test_slow_heartbeat_names_its_remedies(bus, period_ms, sayable):
    bus.objects[3, 0x1017, 0] = struct.pack("<H", period_ms)
    with pytest.raises(MappingMismatch, match="node 3, 1017h sub 0") as refused:
        make(bus).connect()
    said = str(refused.value)
    assert "Set 1017h in these drives as expected, with their maker's tool" in said
    assert ("heartbeat: slowest_ms" in said) is sayable
    assert ("no bus profile can accept another value" in said) is not sayable
    assert "probe --draft" not in said


def test_each_difference_has_its_own_remedy(bus):
    bus.objects[3, 0x1005, 0] = struct.pack("<L", 0x81)
    bus.objects[4, 0x1A00, 2] = struct.pack("<L", 0x606C0020)
    with pytest.raises(MappingMismatch) as refused:
        make(bus).connect()
    said = str(refused.value)
    assert "Set 1005h in these drives as expected, with their maker's tool" in said
    assert "commission them as expected, or describe them in a bus profile" in said


@pytest.mark.parametrize(
    ("index", "form", "value"), [(0x6071, "<h", -50), (0x60B2, "<h", 200), (0x60B0, "<l", 4000)]
)
def test_nonzero_torque_or_offset_is_refused(bus, index, form, value):
    bus.objects[3, index, 0] = struct.pack(form, value)
    with pytest.raises(MappingMismatch) as refused:
        make(bus).connect()
    assert refused.value.differences == (f"node 3, {index:04X}h: expected 0, found {value}",)
    said = str(refused.value)
    assert f"Set {index:04X}h in these drives as expected, with their maker's tool" in said
    assert "send it as 0 with the commands, or write 0 (pdo_maps: configured), then connect" in said
    for wrong in ("probe --draft", "no bus profile can accept another value"):
        assert wrong not in said
    assert not [identifier for identifier, _ in bus.sent if 0x200 < identifier <= 0x207]


def test_zero_or_absent_offsets_are_accepted(connected, bus):
    bus.objects[3, 0x6071, 0] = bus.objects[3, 0x60B2, 0] = bytes(2)
    connected()

"""Drives with other PDO, heartbeat or following-error settings are refused by name before anything is enabled."""

import math
import struct
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import pytest

from hardware.arm_description import JointScale
from hardware.canopen.drive_settings import following_windows_counts, ignores_operator_timeout
from hardware.errors import MappingMismatch, SdoRefused
from tests.hardware.control.canopen_arm.conftest import make
from tests.hardware.fake_arm import FakeArmBus
from tests.oracles.profiles import sarcos

OPERATOR = 127
COUNTS_PER_DEGREE = 400_000 / 360
ABSENT = 0x06020000


@pytest.fixture
def bus(bus):
    yield bus
    assert (bus.commands, bus.token) == ([], 0)


def connection_refusal(bus: FakeArmBus) -> MappingMismatch:
    with pytest.raises(MappingMismatch) as refused:
        make(bus).connect()
    return refused.value


def u32(value: int) -> bytes:
    return struct.pack("<L", value)


@pytest.mark.sample(6)
@pytest.mark.parametrize(
    ("place", "value"),
    [
        ((3, 0x1A00, 2), u32(0x606C0020)),
        ((3, 0x1A00, 0), u32(2)),
        ((3, 0x1A00, 0), ABSENT),
        ((5, 0x1600, 2), u32(0x60FF0020)),
        ((2, 0x1400, 1), u32(0x203)),
        ((2, 0x1400, 1), u32(0x80000202)),
        ((2, 0x1400, 2), b"\x01"),
        ((6, 0x1800, 1), u32(0x40000187)),
        ((6, 0x1800, 2), b"\xff"),
        ((1, 0x1005, 0), u32(0x40000080)),
        ((1, 0x1014, 0), u32(0x82)),
        ((4, 0x1401, 1), u32(0x201)),
        ((2, 0x1019, 0), b"\xf0"),
        ((2, 0x1800, 3), b"\xe8\x03"),
        ((2, 0x1800, 6), b"\x01"),
        ((2, 0x6064, 0), u32(150_000)),  # not the position in the TPDO
    ],
)
def test_mapping_difference_names_node_object_expected_and_actual(bus, place, value, approve):
    bus.objects[place] = value
    refusal = connection_refusal(bus)
    approve(str(refusal))
    assert len(refusal.differences) == 1


RPDO, TPDO = 0x1400, 0x1800


@pytest.mark.sample(6)
@pytest.mark.parametrize(
    ("record", "number", "cob_id"),
    [
        (RPDO, 5, 0x201),  # the command of joint 1
        (RPDO, 16, 0x207),
        (RPDO, 6, 0x186),  # the answer of joint 6
        (RPDO, 65, 0x201),  # the second axis of one device
        (TPDO, 5, 0x182),
        (TPDO, 2, 0x203),
        *((TPDO, 2, cob_id) for cob_id in (0x000, 0x080, 0x082, 0x0FF)),
        *((TPDO, 2, cob_id) for cob_id in (0x583, 0x605, 0x610, 0x704, 0x710, 0x77F)),
    ],
)
def test_unused_pdo_with_conflicting_cob_id_is_refused(bus, record, number, cob_id):
    bus.objects[4, record + number - 1, 1] = u32(cob_id)
    refusal = connection_refusal(bus)
    (difference,) = refusal.differences
    assert difference.startswith(f"node 4, {record + number - 1:04X}h sub 1: ")
    assert f"found {cob_id:03X}h, " in difference
    assert "probe --draft FILE --configure" in str(refusal)


def test_pdo_record_after_gaps_is_checked(bus):
    """The search ends after 16 absent records in a row."""
    for at in (8, 20, 36):
        bus.objects[4, RPDO + at, 1] = u32(0x80000000)
    bus.objects[4, RPDO + 52, 1] = u32(0x201)
    assert "node 4, 1434h sub 1" in str(connection_refusal(bus))


def test_unrelated_settings_are_accepted(connected, bus):
    bus.objects[2, 0x1000, 0] = u32(0x47020192)  # manufacturer bits of the device type
    bus.objects[3, 0x6071, 0] = bus.objects[3, 0x60B2, 0] = bytes(2)
    bus.objects[4, 0x1401, 1] = u32(0x304)
    bus.objects[4, 0x1404, 1] = u32(0x80000201)
    bus.objects[4, 0x1801, 1] = u32(0x80000181)
    bus.objects[4, 0x1802, 1] = u32(0x384)
    bus.objects[4, 0x1800, 3] = b"\x0a\0"  # 1 ms: the default of some makers
    bus.objects[4, 0x1800, 6] = b"\0"
    bus.objects[4, 0x1019, 0] = b"\0"
    connected()


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
    bus.set_heartbeat_consumers(6, *entries)
    expected = "node 6, 1016h: expected a time-out of at most 10000 ms"
    assert expected in str(connection_refusal(bus))


@pytest.mark.parametrize(
    "entries", [[(OPERATOR, 1)], [(OPERATOR, 10_000)], [(5, 0), (OPERATOR, 500)]]
)
def test_one_valid_heartbeat_consumer_entry_is_accepted(connected, bus, entries):
    bus.set_heartbeat_consumers(6, *entries)
    connected()


@pytest.mark.parametrize(
    ("nodes", "option", "unwatching"),
    [
        ((1, 2, 4, 6, 7), 1, (3, 5)),
        (range(1, 8), 0, (4,)),
        *((range(1, 8), option, ()) for option in (1, 3, -1)),
    ],
)
def test_drives_that_take_no_action_after_the_timeout_are_listed(bus, nodes, option, unwatching):
    for node in nodes:
        bus.set_heartbeat_consumers(node, (OPERATOR, 500))
    bus.objects[4, 0x6007, 0] = struct.pack("<h", option)
    with closing(make(bus)) as arm:
        assert arm.connect().unwatching == unwatching
        ignoring = [node for node in nodes if ignores_operator_timeout(arm.access, node)]
        assert ignoring == [4] * (option == 0)


def test_following_window_is_a_third_of_6065h_or_one_degree():
    unlimited = (0, 0xFFFFFFFF, 400_000, 0x7FFFFFFF, 0xFFFFFFFE)
    limits = {3000: 1000.0, 1: 10.0, 29: 10.0} | dict.fromkeys(unlimited, COUNTS_PER_DEGREE)
    counts_per_rad = 360 * COUNTS_PER_DEGREE / math.tau
    scales = [JointScale(counts_per_rad=(-1) ** k * counts_per_rad) for k in range(len(limits))]
    counts = {(node, 0x6065, 0): value for node, value in enumerate(limits, 1)}
    sdo: Any = SimpleNamespace(read_unsigned=lambda *place: counts[place])
    windows = following_windows_counts(sdo, sarcos(len(limits)), scales)
    assert windows == pytest.approx([*limits.values()])


ACCEPT, ACCEPT_NONE = "heartbeat: slowest_ms", "a bus profile cannot change this"
ZERO = "send it as 0 with the commands, or write 0 (pdo_maps: configured), then connect"


@pytest.mark.parametrize(
    ("index", "form", "value", "difference", "remedy", "wrong_remedy"),
    [
        (0x1017, "<H", 5000, " sub 0:", ACCEPT, ACCEPT_NONE),
        (0x1017, "<H", 10_001, " sub 0:", ACCEPT_NONE, ACCEPT),
        (0x1017, "<H", 0, " sub 0:", ACCEPT_NONE, ACCEPT),
        (0x6071, "<h", -50, ": expected 0, found -50", ZERO, ACCEPT_NONE),
        (0x60B2, "<h", 200, ": expected 0, found 200", ZERO, ACCEPT_NONE),
        (0x60B0, "<l", 4000, ": expected 0, found 4000", ZERO, ACCEPT_NONE),
    ],
)
def test_heartbeat_torque_or_offset_is_refused_with_its_remedies(
    bus, index, form, value, difference, remedy, wrong_remedy
):
    bus.objects[3, index, 0] = struct.pack(form, value)
    refusal = connection_refusal(bus)
    (text,) = refusal.differences
    assert f"{text} ".startswith(f"node 3, {index:04X}h{difference} ")
    by_tool = f"Set {index:04X}h in these drives as expected, with their maker's tool"
    for part in (by_tool, remedy, wrong_remedy, "probe --draft"):
        assert (part in str(refusal)) is (part in (by_tool, remedy))


def test_each_difference_has_its_own_remedy(bus):
    bus.objects[3, 0x1005, 0] = struct.pack("<L", 0x81)
    bus.objects[4, 0x1A00, 2] = struct.pack("<L", 0x606C0020)
    message = str(connection_refusal(bus))
    assert "Set 1005h in these drives as expected, with their maker's tool" in message
    assert "Set up the other objects of these drives as expected" in message


@pytest.mark.sample(1)
@pytest.mark.parametrize("code", [0x08000000, 0x06010000, 0x06040043, 0x05040001, 0x12345678])
def test_objects_refused_like_index_0000h_are_absent(bus, code):
    """A drive with an abort code of its own for objects that it does not have."""
    of = bus.object_of

    def answer(node: int, index: int, sub: int) -> bytes | int:
        value = of(node, index, sub)
        return code if node == 2 and value in (0x06020000, 0x06090011) else value

    bus.object_of = answer
    with closing(make(bus)) as arm:
        assert 2 in arm.connect().unwatching


@pytest.mark.parametrize("index", [0x1019, 0x6071])
def test_object_that_exists_but_cannot_be_read_is_refused(bus, index):
    bus.objects[2, index, 0] = 0x08000000
    with pytest.raises(SdoRefused, match=f"node 2 refused {index:04X}h sub 0"):
        make(bus).connect()


def test_count_of_map_entries_is_one_byte(connected, bus):
    """An answer that states no size has garbage beyond it."""
    bus.objects[3, 0x1A00, 0] = u32(0x5A5A5A03)
    connected()

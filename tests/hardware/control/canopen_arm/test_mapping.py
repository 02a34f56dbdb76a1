"""Drives with other PDO settings are refused by name before anything is enabled."""

import struct

import pytest

from hardware.errors import MappingMismatch, SdoRefused
from tests.hardware.on_fake_bus import make

ABSENT = 0x06020000


@pytest.fixture
def bus(bus):
    yield bus
    assert bus.commands == []
    assert bus.token == 0


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
    ],
)
def test_mapping_difference_names_node_object_expected_and_found(bus, place, value, approve):
    bus.objects[place] = value
    with pytest.raises(MappingMismatch) as refused:
        make(bus).connect()
    approve(str(refused.value))
    assert len(refused.value.differences) == 1


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
    with pytest.raises(MappingMismatch) as refused:
        make(bus).connect()
    assert refused.value.differences == (
        f"node 4, {record + number - 1:04X}h sub 1: expected an identifier that no other frame "  # noqa: ISC004
        f"of this arm has, found {cob_id:03X}h",
    )


def test_pdo_record_after_gaps_is_checked(bus):
    """The search ends after 16 absent records in a row."""
    for at in (8, 20, 36):
        bus.objects[4, RPDO + at, 1] = u32(0x80000000)
    bus.objects[4, RPDO + 52, 1] = u32(0x201)
    with pytest.raises(MappingMismatch, match="node 4, 1434h sub 1"):
        make(bus).connect()


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


def test_tpdo_contradicting_its_mapping_is_refused(bus):
    bus.objects[2, 0x6064, 0] = struct.pack("<l", 150_000)
    with pytest.raises(MappingMismatch) as refused:
        make(bus).connect()
    assert refused.value.differences == (
        "node 2, 6064h: expected the 150000 counts that it holds, found 2000 in TPDO1",
    )


@pytest.mark.sample(1)
@pytest.mark.parametrize("code", [0x08000000, 0x06010000, 0x06040043, 0x05040001, 0x12345678])
def test_objects_refused_like_index_0000h_are_absent(bus, code):
    """A drive with an abort code of its own for objects that it does not have."""
    of = bus.object_of

    def answer(node: int, index: int, sub: int) -> bytes | int:
        value = of(node, index, sub)
        return code if node == 2 and value in (0x06020000, 0x06090011) else value

    bus.object_of = answer
    arm = make(bus)
    assert 2 in arm.connect().unwatching
    arm.close()


@pytest.mark.parametrize("index", [0x1019, 0x6071])
def test_object_that_exists_but_cannot_be_read_is_refused(bus, index):
    bus.objects[2, index, 0] = 0x08000000
    with pytest.raises(SdoRefused, match=f"node 2 refused {index:04X}h sub 0"):
        make(bus).connect()


def test_count_of_map_entries_is_one_byte(bus):
    """An answer that states no size has garbage beyond it."""
    bus.objects[3, 0x1A00, 0] = u32(0x5A5A5A03)
    arm = make(bus)
    arm.connect()
    arm.close()

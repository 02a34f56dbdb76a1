"""A drive whose frames carry something else is refused by name before anything is enabled."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest

from hardware.errors import MappingDiffers
from tests.hardware.fake_arm import FakeArmBus
from tests.hardware.test_canopen_arm import make

ABSENT = 0x06020000


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hardware.connection.LISTEN_S", 0.02)
    monkeypatch.setattr("hardware.connection.BOOT_TIMEOUT_S", 0.5)


@pytest.fixture
def bus() -> Iterator[FakeArmBus]:
    fake = FakeArmBus()
    fake.drives[7].counts = 100
    yield fake
    # Whatever was refused, no drive was told anything.
    assert not [i for i, _ in fake.sent if 0x200 < i <= 0x207]
    assert fake.token == 0


def u32(value: int) -> bytes:
    return struct.pack("<L", value)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (
            (3, 0x1A00, 2),
            u32(0x606C0020),
            "node 3, 1A00h: expected TPDO1 = 6041h(16) + 6064h(32) + 6077h(16), "  # noqa: ISC004
            "found 6041h(16) + 606Ch(32) + 6077h(16)",
        ),
        ((3, 0x1A00, 0), u32(2), "node 3, 1A00h: expected TPDO1 = "),
        ((3, 0x1A00, 0), ABSENT, "found no such object"),
        ((5, 0x1600, 2), u32(0x60FF0020), "node 5, 1600h: expected RPDO1 = "),
        ((2, 0x1400, 1), u32(0x203), "node 2, 1400h sub 1: expected 202h, found 203h"),
        ((2, 0x1400, 1), u32(0x80000202), "1400h sub 1: expected 202h, found 80000202h"),
        ((2, 0x1400, 2), b"\x01", "1400h sub 2: expected transmission type 254 or 255, found 1"),
        ((6, 0x1800, 1), u32(0x40000187), "node 6, 1800h sub 1: expected 186h, found 40000187h"),
        ((6, 0x1800, 2), b"\xff", "1800h sub 2: expected transmission type 1, found 255"),
        ((1, 0x1005, 0), u32(0x40000080), "node 1, 1005h sub 0: expected 080h, found 40000080h"),
        ((1, 0x1014, 0), u32(0x82), "node 1, 1014h sub 0: expected 081h, found 082h"),
        ((4, 0x1401, 1), u32(0x201), "node 4, 1401h sub 1: expected another identifier, or none"),
    ],
)
def test_what_differs_is_named_with_node_object_expected_and_found(
    bus: FakeArmBus, place: tuple[int, int, int], value: bytes | int, words: str
) -> None:
    bus.objects[place] = value
    with pytest.raises(MappingDiffers) as refused:
        make(bus).connect()
    assert words in str(refused.value)
    assert len(refused.value.differences) == 1


def test_everything_that_differs_is_named_at_once(bus: FakeArmBus) -> None:
    bus.objects[3, 0x1A00, 2] = u32(0x606C0020)
    bus.objects[5, 0x1400, 2] = b"\x00"
    with pytest.raises(MappingDiffers) as refused:
        make(bus).connect()
    assert [text[:7] for text in refused.value.differences] == ["node 3,", "node 5,"]


def test_a_further_pdo_elsewhere_is_nobodys_business(bus: FakeArmBus) -> None:
    bus.objects[4, 0x1401, 1] = u32(0x304)
    bus.objects[4, 0x1801, 1] = u32(0x80000181)
    arm = make(bus)
    arm.connect()
    arm.close()


def test_a_map_that_reads_well_and_a_frame_that_does_not_agree(bus: FakeArmBus) -> None:
    """What the dictionary says and what the drive sends are two things."""
    bus.objects[2, 0x6064, 0] = struct.pack("<l", 150_000)
    with pytest.raises(MappingDiffers) as refused:
        make(bus).connect()
    assert refused.value.differences == (
        "node 2, 6064h: expected the 150000 counts that it holds, found 2000 in TPDO1",
    )

"""A torque or an offset that somebody left in a drive: named, or written to 0, before anything is enabled."""

import struct

import pytest

from hardware.errors import MappingMismatch
from tests.hardware.fake_arm import FakeArmBus
from tests.hardware.on_fake_bus import make


@pytest.mark.parametrize(
    ("index", "form", "value"), [(0x6071, "<h", -50), (0x60B2, "<h", 200), (0x60B0, "<l", 4000)]
)
def test_what_a_drive_would_add_is_refused_by_name(
    bus: FakeArmBus, index: int, form: str, value: int
) -> None:
    bus.objects[3, index, 0] = struct.pack(form, value)
    with pytest.raises(MappingMismatch) as refused:
        make(bus).connect()
    assert refused.value.differences == (f"node 3, {index:04X}h: expected 0, found {value}",)
    said = str(refused.value)
    assert f"Set {index:04X}h in these drives as expected, with their maker's tool" in said
    assert "send it as 0 with the commands, or write 0 (pdo_maps: configured), then connect" in said
    for wrong in ("probe --draft", "no bus profile can allow for that"):
        assert wrong not in said
    assert not [identifier for identifier, _ in bus.sent if 0x200 < identifier <= 0x207]


def test_zeroes_and_absent_objects_are_fine(bus: FakeArmBus) -> None:
    bus.objects[3, 0x6071, 0] = bus.objects[3, 0x60B2, 0] = bytes(2)
    arm = make(bus)
    assert arm.connect().configured == ()
    arm.close()

"""Each possible difference of an arm from its description, on a fake bus."""

import pytest

from hardware.errors import WrongArm
from tests.hardware.control.canopen_arm.conftest import make
from tests.hardware.fake_arm import FakeArmBus


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ((16, 0x2020, 3), "03"),
        ((1, 0x1000, 0), "92010100"),
        ((1, 0x2100, 1), "02"),
        ((7, 0x2100, 1), "01"),
        ((1, 0x608F, 2), "02000000"),
        ((7, 0x2100, 3), "0e"),
        ((7, 0x2100, 2), "fe0d2707"),
        ((1, 0x607D, 1), "cfffffff"),
        ((2, 0x60C2, 1), "14"),
    ],
)
def test_single_difference_from_arm_file_is_reported(entry, value, approve):
    bus = FakeArmBus()
    bus.objects[entry] = bytes.fromhex(value)
    with pytest.raises(WrongArm) as wrong:
        make(bus).connect()
    approve(str(wrong.value))
    assert str(wrong.value).count(";") == 0


def test_every_difference_from_arm_file_is_reported():
    bus = FakeArmBus()
    bus.objects[16, 0x2020, 1] = b"other"
    bus.objects[2, 0x607D, 2] = bus.objects[4, 0x608F, 1] = bytes.fromhex("e8030000")
    bus.objects[5, 0x608F, 1] = bus.objects[5, 0x608F, 2] = bytes(4)
    bus.objects[7, 0x2100, 2] = bytes.fromhex("80778e06")
    with pytest.raises(WrongArm, match="'other'") as wrong:
        make(bus).connect()
    for part in (
        "joint 2 has the range",
        "joint 4 has an encoder",
        "joint 5 has an encoder of 0 counts per 0 turns",
        "joint 7 has an RVDT of 110.000000 deg",
    ):
        assert part in str(wrong.value)
    assert "joint 1 " not in str(wrong.value)

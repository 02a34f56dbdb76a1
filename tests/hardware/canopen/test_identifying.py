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

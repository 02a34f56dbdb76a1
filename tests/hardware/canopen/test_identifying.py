"""Every way an arm may differ from its description, one at a time, on a fake object dictionary."""

import math

import pytest

from hardware.arm import ArmIdentity
from hardware.arm_description import EncoderDescription, RvdtDescription
from hardware.canopen.identifying import check_arm
from hardware.errors import WrongArm
from tests.oracles.descriptions import described
from tests.oracles.profiles import sarcos

Objects = dict[tuple[int, int, int], int | str]


class FakeAccess:
    """Object access to a dictionary."""

    def __init__(self, objects: Objects) -> None:
        self.objects = objects

    def read_unsigned(self, node: int, index: int, subindex: int = 0) -> int:
        return int(self.objects[node, index, subindex])

    read_signed = read_unsigned


@pytest.fixture
def objects():
    found: Objects = {(16, 0x2020, 3): 2}
    for node, low, high in ((1, -50, 50), (2, -1024, 1024)):
        found |= {
            (node, 0x1000, 0): 0x00020192,
            (node, 0x607D, 1): low,
            (node, 0x607D, 2): high,
            (node, 0x608F, 1): 400,
            (node, 0x608F, 2): 2,
            (node, 0x60C2, 1): 10,
            (node, 0x60C2, 2): -3,
            (node, 0x2100, 1): node,
            (node, 0x2100, 2): 120_000_000,
            (node, 0x2100, 3): 12,
        }
    return found


DESCRIPTION = described(
    "two joints",
    (EncoderDescription(counts_per_rev=200), math.pi / 2),
    (RvdtDescription(bits=12, full_scale_rad=math.radians(120)), math.radians(30)),
)


def check(objects: Objects, model: str = "two joints") -> None:
    identity = ArmIdentity(model=model, serial_number="X", nodes=())
    access = FakeAccess(objects)
    check_arm(access, identity, DESCRIPTION, sarcos(2), period_s=0.01)  # type: ignore[arg-type]


def test_the_arm_described_is_accepted(objects):
    check(objects)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ((16, 0x2020, 3), 3),
        ((1, 0x1000, 0), 0x00010192),
        ((1, 0x2100, 1), 2),
        ((2, 0x2100, 1), 1),
        ((1, 0x608F, 1), 401),
        ((2, 0x2100, 3), 14),
        ((2, 0x2100, 2), 119_999_998),
        ((1, 0x607D, 1), -49),
        ((2, 0x60C2, 1), 20),
    ],
)
def test_one_difference_is_named(objects, place, value, approve):
    with pytest.raises(WrongArm) as wrong:
        check({**objects, place: value})
    approve(str(wrong.value))
    assert str(wrong.value).count(";") == 0


def test_another_model_is_named(objects):
    with pytest.raises(WrongArm, match="model is 'other', expected 'two joints'"):
        check(objects, model="other")

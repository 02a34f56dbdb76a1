"""The arm on its fake bus, connected, and driven."""

from collections.abc import Iterator

import pytest

from hardware.control.canopen_arm import CanopenArm
from tests.hardware.fake_arm import FakeArmBus
from tests.hardware.on_fake_bus import TWO_DRIVEN, make


@pytest.fixture
def bus() -> FakeArmBus:
    fake = FakeArmBus()
    fake.drives[7].counts = 100
    return fake


@pytest.fixture
def arm(bus: FakeArmBus) -> Iterator[CanopenArm]:
    made = make(bus)
    made.connect()
    yield made
    bus.broken = None
    made.close()


@pytest.fixture
def driven(arm: CanopenArm) -> CanopenArm:
    arm.take_control()
    arm.set_modes(TWO_DRIVEN)
    return arm

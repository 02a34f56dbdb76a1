"""The arm of the contract on every transport: at rest, connected, driven."""

from collections.abc import Iterator

import pytest

from hardware.buses.python_can import BusSettings
from hardware.control.canopen_arm import CanopenArm
from hardware.virtual.controller import VirtualController
from tests.contracts.arm.bench import TWO_DRIVEN, controller_on, operator_on


@pytest.fixture
def controller(settings: BusSettings) -> Iterator[VirtualController]:
    with controller_on(settings) as running:
        yield running


@pytest.fixture
def arm(controller: VirtualController, settings: BusSettings) -> Iterator[CanopenArm]:
    made = operator_on(settings)
    made.connect()
    yield made
    made.close()


@pytest.fixture
def driven(arm: CanopenArm) -> CanopenArm:
    arm.take_control()
    arm.set_modes(TWO_DRIVEN)
    return arm

"""The arm of the contract on every transport: at rest, connected, driven."""

import pytest

from tests.contracts.arm.bench import TWO_DRIVEN, controller_on, operator_on


@pytest.fixture
def controller(settings):
    with controller_on(settings) as running:
        yield running


@pytest.fixture
def arm(controller, settings):
    made = operator_on(settings)
    made.connect()
    yield made
    made.close()


@pytest.fixture
def driven(arm):
    arm.take_control()
    arm.set_modes(TWO_DRIVEN)
    return arm

"""The arm under contract on every transport."""

import pytest

from tests.contracts.arm.bench import controller_on, operator_on, take_two_joints


@pytest.fixture
def controller(settings):
    with controller_on(settings) as running:
        yield running


@pytest.fixture
def arm(controller, settings):
    arm = operator_on(settings)
    arm.connect()
    yield arm
    arm.close()


@pytest.fixture
def driven(arm):
    return take_two_joints(arm)

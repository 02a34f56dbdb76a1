"""A foreign arm on a channel of its own, and an operator that connects to it."""

import itertools
from contextlib import ExitStack

import pytest

from hardware.buses.python_can import BusSettings
from hardware.canopen.bus_profile import BusProfile
from hardware.control.canopen_arm import CanopenArm
from tests.hardware.on_foreign_arm import running_foreign_arm, unconnected

_channels = itertools.count()


@pytest.fixture
def settings():
    return BusSettings(channel=f"foreign-{next(_channels)}")


@pytest.fixture
def foreign(settings):
    """An arm with the node numbers of ours, and another set-up."""
    yield from running_foreign_arm(settings, 1, 2, 3, 4)


@pytest.fixture
def connect(settings):
    """Connect an arm with a profile; it is closed after the test."""
    with ExitStack() as stack:

        def connected(profile: BusProfile) -> CanopenArm:
            arm = unconnected(settings, profile)
            arm.connect()
            stack.callback(arm.close)
            return arm

        yield connected

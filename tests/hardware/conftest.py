"""A foreign arm on a channel of its own, and who connects to it."""

import itertools
from contextlib import ExitStack

import pytest

from hardware.buses.python_can import BusSettings
from hardware.canopen.bus_profile import BusProfile
from hardware.control.canopen_arm import CanopenArm
from tests.hardware.on_foreign_arm import on, unconnected

_channels = itertools.count()


@pytest.fixture
def settings():
    return BusSettings(channel=f"foreign-{next(_channels)}")


@pytest.fixture
def foreign(settings):
    """On the node numbers that ours has, so that nothing differs but how they are set up."""
    yield from on(settings, 1, 2, 3, 4)


@pytest.fixture
def connect(settings):
    """Connect with a profile; the arm is closed in the end."""
    with ExitStack() as stack:

        def connected(profile: BusProfile) -> CanopenArm:
            arm = unconnected(settings, profile)
            arm.connect()
            stack.callback(arm.close)
            return arm

        yield connected

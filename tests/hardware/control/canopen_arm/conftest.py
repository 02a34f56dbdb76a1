"""The arm on its fake bus, connected, and driven."""

from contextlib import ExitStack
from typing import Any

import pytest

from hardware.control.canopen_arm import CanopenArm
from hardware.timing import Pace
from tests.hardware.fake_arm import FakeArmBus
from tests.hardware.on_fake_bus import drive, hasty, make


@pytest.fixture
def bus():
    return FakeArmBus()


@pytest.fixture
def connected(bus):
    """Connect an arm of these options, on the fixture's bus or another; it is closed in the end."""
    with ExitStack() as stack:

        def connect(on: FakeArmBus = bus, **options: Any) -> CanopenArm:
            made = make(on, **options)
            made.connect()
            stack.callback(made.close)
            stack.callback(setattr, on, "broken", None)
            return made

        yield connect


@pytest.fixture
def arm(connected):
    return connected()


@pytest.fixture
def driven(arm):
    return drive(arm)


@pytest.fixture
def live(connected):
    """A driven arm ten times as fast as one is: nothing is asked of it, and SYNCs go on."""
    return drive(connected(pace=Pace.REAL_TIME, timing=hasty(speed=10.0)))

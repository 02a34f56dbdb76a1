"""An arm on its fake bus: connected, or with two joints driven."""

from contextlib import ExitStack
from typing import Any

import pytest

from hardware.control.canopen_arm import CanopenArm
from hardware.timing import Pace
from tests.hardware.fake_arm import FakeArmBus
from tests.hardware.on_fake_bus import drive, make, short_timing


@pytest.fixture
def bus():
    return FakeArmBus()


@pytest.fixture
def connected(bus):
    """Connect an arm with these options, on the fixture's bus or another; it is closed after the test."""
    with ExitStack() as stack:

        def connect(on: FakeArmBus = bus, **options: Any) -> CanopenArm:
            arm = make(on, **options)
            arm.connect()
            stack.callback(arm.close)
            stack.callback(setattr, on, "io_error", None)
            return arm

        yield connect


@pytest.fixture
def arm(connected):
    return connected()


@pytest.fixture
def driven(arm):
    return drive(arm)


@pytest.fixture
def live(connected):
    """A driven arm at ten times real time, which sends SYNCs while idle."""
    return drive(connected(pace=Pace.REAL_TIME, timing=short_timing(speed=10.0)))

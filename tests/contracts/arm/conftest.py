"""The arm under contract, a virtual controller on a bus, and its operator, on every transport."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import pytest

from hardware.buses.python_can import BusSettings, open_bus
from hardware.control.canopen_arm import CanopenArm
from hardware.virtual.axis import arm_axes
from hardware.virtual.controller import VirtualController
from hardware.virtual.scenarios import scenario
from hardware.virtual.supervisor_node import ArmLabel
from operator_app.config.arm_file import load_arm
from tests.hardware.control.canopen_arm.conftest import drive
from tests.oracles.fast_arm import fast_arm
from tests.oracles.virtual_rig import parse

SERIAL = "SDA-0007"
SCENARIO = scenario("datasheet", 3)
MODEL = SCENARIO.arm(load_arm("sarcos_dextrous"))


@contextmanager
def controller_on(settings: BusSettings) -> Iterator[VirtualController]:
    with (
        open_bus(settings) as bus,
        VirtualController(
            bus,
            SCENARIO.build(MODEL),
            axes=arm_axes(MODEL),
            arm=ArmLabel(model=MODEL.name, serial_number=SERIAL),
            validate=partial(parse, of=arm_axes(MODEL)),
            heartbeat_timeout_s=10.0,  # both ends share a processor, without real-time priority
        ) as controller,
    ):
        yield controller


def operator_on(settings: BusSettings, **waits: float) -> CanopenArm:
    """Return the operator's side of the arm, not connected."""
    return fast_arm(MODEL, settings, patience_s=10.0, listen_s=0.15, **waits)


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
    return drive(arm)

"""An operator's arm on a fake bus: not connected, connected, or with two joints driven."""

import math
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import pytest

from hardware.arm import JointMode
from hardware.arm_description import EncoderDescription, RvdtDescription
from hardware.buses.python_can import ArmOnBus, BusSettings
from hardware.control.canopen_arm import CanopenArm
from hardware.timing import Pace, Timing
from tests.hardware.fake_arm import COUNTS_PER_REV, JOINTS, FakeArmBus
from tests.oracles.descriptions import described
from tests.oracles.profiles import sarcos

PER_RAD = COUNTS_PER_REV / (2 * math.pi)
POSITION, FREE = JointMode.POSITION, JointMode.FREE
TWO_DRIVEN = [FREE, POSITION, FREE, FREE, POSITION, FREE, FREE]
ENCODER = EncoderDescription(counts_per_rev=COUNTS_PER_REV), math.pi / 2
WRIST = RvdtDescription(bits=12, full_scale_rad=math.radians(120)), math.radians(30)
DESCRIPTION = described("fake", *[ENCODER] * (JOINTS - 1), WRIST)


def short_timing(**options: Any) -> Timing:
    """Time-outs no longer than the fake bus needs."""
    times = {"listen_s": 0.02, "boot_timeout_s": 1.0, "upload_retry_s": 0.01}
    return Timing(answer_timeouts_s=dict.fromkeys(Pace, 0.05), **{**times, **options})


def make(bus: FakeArmBus, **options: Any) -> CanopenArm:
    opener = options.pop("opener", lambda _settings: bus)
    stop_opener = options.pop("stop_opener", lambda _settings: bus.stop_handle())
    on_bus = ArmOnBus(
        DESCRIPTION,
        BusSettings(channel="fake"),
        options.pop("profile", sarcos()),
        pace=options.pop("pace", Pace.FAST_FORWARD),
        timing=options.pop("timing", short_timing(heartbeat_timeout_s=0.35)),
        open_main=opener,
        open_stop=stop_opener,
    )
    return CanopenArm(on_bus, **options)


def drive(arm: CanopenArm) -> CanopenArm:
    """Take control, with the two driven joints of a closed loop in position mode."""
    arm.take_control()
    arm.set_modes(TWO_DRIVEN)
    return arm


def wait_for(condition: Callable[[], bool]) -> None:
    """Spin until a condition holds, or pytest's own timeout ends the test."""
    while not condition():
        pass


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

"""An arm with drives of another set-up, on a channel of its own, and an operator that connects to it."""

import math
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import can
import pytest

from hardware.arm_description import ArmDescription, EncoderDescription
from hardware.buses.python_can import BusSettings, open_bus
from hardware.buses.shared_bus import SharedBus
from hardware.canopen.bus_profile import BusProfile
from hardware.commissioning.probe import probe
from hardware.commissioning.profile_draft import draft
from hardware.control.canopen_arm import CanopenArm
from operator_app.config.profile_file import format_profile, parse_profile
from tests.oracles.descriptions import described
from tests.oracles.fast_arm import fast_arm
from tests.oracles.foreign_arm import Axis, ForeignArm
from tests.oracles.profiles import sarcos

JOINTS, COUNTS_PER_REV = 4, 36_000
PER_RAD = COUNTS_PER_REV / math.tau
DESCRIPTION = described(
    "acme", *[(EncoderDescription(counts_per_rev=COUNTS_PER_REV), 1.5)] * JOINTS
)


def running_foreign_arm(settings: BusSettings, *nodes: int) -> Iterator[ForeignArm]:
    axes = [Axis(counts=1000 * (k + 1)) for k in range(JOINTS)]
    with (
        can.Bus(settings.channel, interface="virtual") as bus,
        closing(ForeignArm(bus, nodes, axes)) as arm,
    ):
        yield arm


def unconnected(
    settings: BusSettings,
    profile: BusProfile,
    description: ArmDescription = DESCRIPTION,
    **options: Any,
) -> CanopenArm:
    waits = {"listen_s": 0.15, "boot_timeout_s": 1.0, "answers_s": 2.0, "patience_s": 5.0}
    return fast_arm(description, settings, profile, **waits, **options)


def drafted(settings: BusSettings, *, configure: bool = False) -> BusProfile:
    """Probe the bus and draft a profile, which survives being written to a file."""
    nodes = probe(SharedBus(open_bus(settings)), sarcos()).nodes
    profile = draft(nodes, name="acme", configure=configure)
    text = format_profile(profile, comment="drafted")
    assert parse_profile(text, "acme.yaml", joints=JOINTS) == profile
    return profile


@pytest.fixture
def settings(request):
    return BusSettings(channel=request.node.name)


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

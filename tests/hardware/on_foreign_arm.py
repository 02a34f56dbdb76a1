"""An arm with drives of another set-up, for the tests of profiles and of the bench check."""

import math
from collections.abc import Callable, Iterator

import can

from hardware.arm_description import ArmDescription, EncoderDescription
from hardware.buses.python_can import ArmOnBus, BusOpeners, BusSettings, open_bus
from hardware.canopen.bus_profile import BusProfile
from hardware.commissioning.probe import probe
from hardware.commissioning.profile_draft import draft
from hardware.control.canopen_arm import CanopenArm
from hardware.timing import Pace, Timing
from operator_app.config.profile_file import format_profile, parse_profile
from tests.oracles.descriptions import described
from tests.oracles.foreign_arm import Axis, ForeignArm, foreign_arm
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
        foreign_arm(bus, nodes, axes) as arm,
    ):
        yield arm


def unconnected(
    settings: BusSettings,
    profile: BusProfile,
    description: ArmDescription = DESCRIPTION,
    *,
    pace: Pace = Pace.FAST_FORWARD,
    opener: Callable[[BusSettings], can.BusABC] = open_bus,
) -> CanopenArm:
    timing = Timing(
        listen_s=0.15,
        boot_timeout_s=1.0,
        answer_timeouts_s=dict.fromkeys(Pace, 2.0),
        heartbeat_timeout_s=5.0,
        lost_after_s=5.0,
    )
    openers = BusOpeners(main=opener)
    return CanopenArm(
        ArmOnBus(description, settings, profile, pace=pace, timing=timing, openers=openers)
    )


def drafted(settings: BusSettings, *, configure: bool = False) -> BusProfile:
    """Probe the bus and draft a profile, which survives being written to a file."""
    nodes = probe(settings, sarcos(), listen_s=0.5, answers_s=1.0).nodes
    profile = draft(nodes, name="acme", configure=configure)
    text = format_profile(profile, comment="drafted")
    assert parse_profile(text, "acme.yaml", joints=JOINTS) == profile
    return profile

"""Which arm is expected on which bus, and how it is talked to there. Opens nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import can

from hardware.arm_description import ArmDescription
from hardware.buses.python_can import BusSettings, open_bus, open_sender
from hardware.canopen.bus_profile import BusProfile
from hardware.timing import Pace, Timing


@dataclass(frozen=True, slots=True, kw_only=True)
class BusOpeners:
    """How the two handles on a bus are opened."""

    main: Callable[[BusSettings], can.BusABC] = open_bus
    stop: Callable[[BusSettings], can.BusABC] = open_sender


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOnBus:
    """The arm that is expected on a bus, and how it is talked to there.

    Attributes
    ----------
    description
        The arm expected.
    settings, openers
        The bus, and how to open it.
    profile
        How its nodes are set up.
    pace, timing
        When SYNCs go out; periods and time-outs of the control loop.
    """

    description: ArmDescription
    settings: BusSettings
    profile: BusProfile
    pace: Pace
    timing: Timing
    openers: BusOpeners

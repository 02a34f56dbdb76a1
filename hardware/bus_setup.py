"""The arm expected on a bus, and the settings of its connection."""

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
    """Functions that open the two handles on a bus."""

    main: Callable[[BusSettings], can.BusABC] = open_bus
    stop: Callable[[BusSettings], can.BusABC] = open_sender


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOnBus:
    """The arm expected, its bus and how to open it, its nodes' set-up, SYNC pace and time-outs."""

    description: ArmDescription
    settings: BusSettings
    profile: BusProfile
    pace: Pace
    timing: Timing
    openers: BusOpeners

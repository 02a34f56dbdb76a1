"""An arm on a bus in fast-forward: the next SYNC follows the last answer."""

from collections.abc import Callable
from typing import Any

import can

from hardware.arm_description import ArmDescription
from hardware.buses.python_can import ArmOnBus, BusSettings, open_bus
from hardware.canopen.bus_profile import BusProfile
from hardware.control.canopen_arm import CanopenArm
from hardware.timing import Pace, Timing
from operator_app.composition import describe
from solver.chain.arm_model import ArmModel
from tests.oracles.profiles import sarcos


def fast_arm(
    arm: ArmModel | ArmDescription,
    settings: BusSettings,
    profile: BusProfile | None = None,
    *,
    patience_s: float,
    answers_s: float | None = None,
    pace: Pace = Pace.FAST_FORWARD,
    open_main: Callable[[BusSettings], can.BusABC] = open_bus,
    **waits: Any,
) -> CanopenArm:
    """The arm, not connected; `patience_s` is its timeout, `answers_s` that of the answers to a SYNC."""
    waits = {"heartbeat_timeout_s": patience_s, "lost_after_s": patience_s, **waits}
    if answers_s is not None:
        waits["answer_timeouts_s"] = dict.fromkeys(Pace, answers_s)
    on_bus = ArmOnBus(
        describe(arm) if isinstance(arm, ArmModel) else arm,
        settings,
        profile or sarcos(),
        pace=pace,
        timing=Timing(**waits),
        open_main=open_main,
    )
    return CanopenArm(on_bus)

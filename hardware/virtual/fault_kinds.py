"""How each fault of `fault_words` is made, by its name. Knows the fault injector; no bus."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from hardware.canopen.objects import SUPERVISOR_NODE, EmergencyCode
from hardware.virtual.faults import FaultInjector, ScriptedFault
from hardware.virtual.frame_faults import FrameFaults

Happen = Callable[[FaultInjector, int], None]
"""Breaks something; the number is a joint's, where it is one joint's affair."""


def _frames(**shares: float) -> Happen:
    return lambda faults, _joint: faults.disturb_frames(FrameFaults(**shares))


FAULT_KINDS: Mapping[str, Happen] = MappingProxyType(
    {
        "frames-lost": _frames(lost=0.01),
        "frames-lost-10": _frames(lost=0.1),
        "frames-doubled": _frames(doubled=0.1),
        "frames-reordered": _frames(swapped=0.1),
        "frames-late": _frames(late=0.05),
        "frames-flipped": _frames(flipped=0.01),
        "babbling": _frames(babble=5.0),
        "bus-flicker": lambda faults, _joint: faults.leave_bus(0.2),
        "bus-off": lambda faults, _joint: faults.leave_bus(3.0),
        "silent-node": FaultInjector.silence,
        "silent-supervisor": lambda faults, _joint: faults.silence(SUPERVISOR_NODE),
        "no-heartbeat": FaultInjector.stop_heartbeat,
        "other-heartbeat": lambda faults, joint: faults.beat_seldom(joint, 5.0),
        "missed-answers": lambda faults, joint: faults.lose_tpdos(joint, 10),
        "double-answers": FaultInjector.answer_twice,
        "wrong-node": FaultInjector.answer_as_another,
        "other-map": FaultInjector.report_speed,
        "sdo-stall": FaultInjector.stall_sdo,
        "sdo-stall-supervisor": lambda faults, _joint: faults.stall_sdo(SUPERVISOR_NODE),
        "sdo-abort": FaultInjector.refuse_sdo,
        "restart-node": FaultInjector.restart_node,
        "restart": lambda faults, _joint: faults.restart(),
        "hang": lambda faults, _joint: faults.hang(),
        "unwatched": FaultInjector.stop_watching,
        "lost-counts-5": lambda faults, joint: faults.lose_counts(joint, -5),
        "lost-counts-500": lambda faults, joint: faults.lose_counts(joint, -500),
        "sensor-jump": lambda faults, joint: faults.jump(joint, math.radians(2.0)),
        "ripple": FaultInjector.ripple,
        "frozen-sensor": FaultInjector.freeze_sensor,
        "broken-sensor": FaultInjector.break_sensor,
        "collision": lambda faults, joint: faults.trip(joint, EmergencyCode.EXCESS_TORQUE),
        "blocked-joint": FaultInjector.block,
        "sagging-drive": FaultInjector.sag,
        "slipped-fixture": lambda faults, _joint: faults.slip_fixture(1e-3),
        "bound-hinge": lambda faults, _joint: faults.bind_hinge(),
        "stray": FaultInjector.go_astray,
        "lost-enable": FaultInjector.lose_enable,
        "deaf-drive": FaultInjector.ignore_targets,
        "emcy-storm": FaultInjector.storm,
        "refused-modes": FaultInjector.refuse_modes,
        "external-stop": lambda faults, _joint: faults.external_stop(),
    }
)


def scripted(kind: str, *, joint: int, at_sync: int) -> ScriptedFault:
    """Return the fault as something that happens at a SYNC; KeyError if there is none of that name."""
    happen = FAULT_KINDS[kind]
    return ScriptedFault(at_sync=at_sync, happen=lambda faults: happen(faults, joint))

"""How each fault of `fault_words` is made, by its name. Knows the fault injector; no bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from hardware.objects import (
    HEARTBEAT_PRODUCER,
    SUPERVISOR_NODE,
    TPDO1_MAP,
    VELOCITY_ACTUAL,
    EmergencyCode,
)
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
        "other-heartbeat": lambda faults, joint: faults.set_up_otherwise(
            joint, HEARTBEAT_PRODUCER, 0, 5000
        ),
        "missed-answers": lambda faults, joint: faults.lose_tpdos(joint, 10),
        "double-answers": FaultInjector.answer_twice,
        "other-map": lambda faults, joint: faults.set_up_otherwise(
            joint, TPDO1_MAP, 2, VELOCITY_ACTUAL << 16 | 32
        ),
        "sdo-stall": FaultInjector.stall_sdo,
        "sdo-stall-supervisor": lambda faults, _joint: faults.stall_sdo(SUPERVISOR_NODE),
        "sdo-abort": FaultInjector.refuse_sdo,
        "restart-node": FaultInjector.restart_node,
        "restart": lambda faults, _joint: faults.restart(),
        "hang": lambda faults, _joint: faults.hang(),
        "unwatched": FaultInjector.stop_watching,
        "lost-counts-5": lambda faults, joint: faults.lose_counts(joint, -5),
        "lost-counts-500": lambda faults, joint: faults.lose_counts(joint, -500),
        "frozen-sensor": FaultInjector.freeze_sensor,
        "broken-sensor": FaultInjector.break_sensor,
        "collision": lambda faults, joint: faults.trip(joint, EmergencyCode.EXCESS_TORQUE),
        "stray": FaultInjector.go_astray,
        "emcy-storm": FaultInjector.storm,
        "refused-modes": FaultInjector.refuse_modes,
        "external-stop": lambda faults, _joint: faults.external_stop(),
    }
)


def scripted(kind: str, *, joint: int, at_sync: int) -> ScriptedFault:
    """Return the fault as something that happens at a SYNC; KeyError if there is none of that name."""
    happen = FAULT_KINDS[kind]
    return ScriptedFault(at_sync=at_sync, happen=lambda faults: happen(faults, joint))

"""Faults by name, for the command line and the campaign: what `sarcal controller --fault` knows. No bus here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from hardware.objects import SUPERVISOR_NODE, EmergencyCode
from hardware.virtual.faults import FaultInjector, ScriptedFault
from hardware.virtual.frame_faults import FrameFaults


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultKind:
    """One thing that can go wrong.

    `text` says what; `happen` does it to a joint, where it is one joint's affair.
    """

    text: str
    happen: Callable[[FaultInjector, int], None]


def _frames(**shares: float) -> Callable[[FaultInjector, int], None]:
    return lambda faults, _: faults.disturb_frames(FrameFaults(**shares))


FAULT_KINDS: Mapping[str, FaultKind] = MappingProxyType(
    {
        "frames-lost": FaultKind(text="1 % of all frames are lost", happen=_frames(lost=0.01)),
        "frames-lost-10": FaultKind(text="10 % of all frames are lost", happen=_frames(lost=0.1)),
        "frames-doubled": FaultKind(
            text="10 % of all frames come twice", happen=_frames(doubled=0.1)
        ),
        "frames-reordered": FaultKind(
            text="10 % of all frames change places with the next", happen=_frames(swapped=0.1)
        ),
        "frames-flipped": FaultKind(
            text="1 % of all frames have one bit of their data flipped",
            happen=_frames(flipped=0.01),
        ),
        "babbling": FaultKind(
            text="five frames of nobody's follow every frame", happen=_frames(babble=5.0)
        ),
        "silent-node": FaultKind(
            text="a joint's cable is cut", happen=lambda faults, joint: faults.silence(joint)
        ),
        "silent-supervisor": FaultKind(
            text="the supervisor's cable is cut",
            happen=lambda faults, _: faults.silence(SUPERVISOR_NODE),
        ),
        "no-heartbeat": FaultKind(
            text="a joint sends no heartbeat",
            happen=lambda faults, joint: faults.stop_heartbeat(joint),
        ),
        "missed-answers": FaultKind(
            text="a joint misses ten SYNCs",
            happen=lambda faults, joint: faults.lose_tpdos(joint, 10),
        ),
        "double-answers": FaultKind(
            text="a joint answers every SYNC twice",
            happen=lambda faults, joint: faults.answer_twice(joint),
        ),
        "restart-node": FaultKind(
            text="a joint's drive restarts, its counter at zero",
            happen=lambda faults, joint: faults.restart_node(joint),
        ),
        "restart": FaultKind(
            text="the whole controller restarts", happen=lambda faults, _: faults.restart()
        ),
        "hang": FaultKind(text="the control loop hangs", happen=lambda faults, _: faults.hang()),
        "lost-counts-5": FaultKind(
            text="an encoder loses 5 counts",
            happen=lambda faults, joint: faults.lose_counts(joint, -5),
        ),
        "lost-counts-500": FaultKind(
            text="an encoder loses 500 counts",
            happen=lambda faults, joint: faults.lose_counts(joint, -500),
        ),
        "frozen-sensor": FaultKind(
            text="a sensor stands still", happen=lambda faults, joint: faults.freeze_sensor(joint)
        ),
        "broken-sensor": FaultKind(
            text="a drive sees that its sensor has failed (7305h)",
            happen=lambda faults, joint: faults.break_sensor(joint),
        ),
        "collision": FaultKind(
            text="a joint trips for excess torque (8311h)",
            happen=lambda faults, joint: faults.trip(joint, EmergencyCode.EXCESS_TORQUE),
        ),
        "refused-modes": FaultKind(
            text="a drive stays in the mode it is in",
            happen=lambda faults, joint: faults.refuse_modes(joint),
        ),
        "external-stop": FaultKind(
            text="the external stop is pressed (5441h)",
            happen=lambda faults, _: faults.external_stop(),
        ),
    }
)


def scripted(kind: str, *, joint: int, at_sync: int) -> ScriptedFault:
    """Return the fault as something that happens at a SYNC; KeyError if there is none of that name."""
    fault = FAULT_KINDS[kind]
    return ScriptedFault(at_sync=at_sync, happen=lambda faults: fault.happen(faults, joint))

"""Fault injection into the virtual controller, for tests and demonstrations.

`FAULT_KINDS` has a function for every fault that `fault_messages` describes. The controller's loop calls the function.
Most functions only change the controller's `Disturbances`. A `ScriptedFault` is injected at a given SYNC, so that a run
with faults is reproducible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from hardware.canopen import objects
from hardware.canopen.objects import EmergencyCode, NmtCommand
from hardware.virtual.disturbances import FaultyWire, FrameFaults

if TYPE_CHECKING:
    from hardware.virtual.controller import VirtualController

RIPPLE_COUNTS = 10.0
"""Standard deviation of the noise of fault ``ripple``: five times that of an RVDT of the paper's arm."""
SLOW_HEARTBEAT_S = 5.0
MISSED_ANSWERS = 10
SLIP_M = 1e-3

FaultAction = Callable[["VirtualController", int], object]
"""Function that injects a fault into the controller; only faults of one joint use the joint number."""


def inject(arm: VirtualController, kind: str, joint: int) -> None:
    """Inject the fault `kind` (`FAULT_KINDS`); may be called from any thread. Faults are injected in order of calls.

    Raises `KeyError` if there is no such fault, `ValueError` if there is no such joint.
    """
    act = FAULT_KINDS[kind]
    if not 1 <= joint <= len(arm.drives):
        raise ValueError(f"there is no joint {joint}")
    arm.post(lambda: act(arm, joint))


def disturb_frames(arm: VirtualController, faults: FrameFaults) -> None:
    """Lose, double, delay or damage frames of all nodes, in both directions; `FrameFaults()` ends these faults."""
    arm.disturbances.wire_out = FaultyWire(faults, 0, clock=arm.now_s)
    arm.disturbances.wire_in = FaultyWire(faults, 1, clock=arm.now_s)


def lose_counts(arm: VirtualController, joint: int, counts: int) -> None:
    """Shift a joint's reading by `counts`, in addition to earlier shifts."""
    lost = arm.disturbances.lost_counts
    lost[joint] = lost.get(joint, 0) + counts


def external_stop(arm: VirtualController, *, pressed: bool) -> None:
    """Press or release the external stop; when it is pressed, all drives trip (5441h) and block their valves."""
    for node in arm.drives:
        node.drive.external_stop = pressed
        if pressed:
            node.drive.trip(EmergencyCode.EXTERNAL_STOP)
    arm.supervisor.send_emergency([EmergencyCode.EXTERNAL_STOP] if pressed else [])


def _frames(**shares: float) -> FaultAction:
    return lambda arm, _joint: disturb_frames(arm, FrameFaults(**shares))


def _leave_bus(seconds: float) -> FaultAction:
    return lambda arm, _joint: setattr(arm.disturbances, "off_until_s", arm.now_s() + seconds)


def _add(faulty: str) -> FaultAction:
    return lambda arm, joint: getattr(arm.disturbances, faulty).add(joint)


def _set_of_joint(faulty: str, value: float) -> FaultAction:
    return lambda arm, joint: getattr(arm.disturbances, faulty).update({joint: value})


def _flag(name: str) -> FaultAction:
    return lambda arm, joint: setattr(arm.drives[joint - 1].drive, name, True)


def _cut_cable(arm: VirtualController, node: int) -> None:
    arm.disturbances.cut_since_s.setdefault(node, arm.now_s())


def _slow_heartbeat(arm: VirtualController, joint: int) -> None:
    arm.drives[joint - 1].answers[objects.HEARTBEAT_PRODUCER, 0] = round(SLOW_HEARTBEAT_S * 1e3)
    arm.disturbances.heartbeat_period_s[joint] = SLOW_HEARTBEAT_S


def _swap_tpdo_id(arm: VirtualController, joint: int) -> None:
    """Make a joint send its TPDO1 with the identifier of the next joint; the last joint uses that of the first."""
    arm.drives[joint - 1].tpdo1_id = objects.COB_TPDO1 + joint % len(arm.drives) + 1


def _report_speed(arm: VirtualController, joint: int) -> None:
    """Make TPDO1 carry the speed in place of the position; the PDO map (1A00h) states the speed too."""
    node = arm.drives[joint - 1]
    node.answers[objects.TPDO1_MAP, 2] = objects.VELOCITY_ACTUAL << 16 | 32
    node.reports_speed = True


def _restart_node(arm: VirtualController, joint: int) -> None:
    """Power-cycle one drive, which then becomes *operational* by itself; its position counts restart at zero."""
    node = arm.drives[joint - 1]
    lose_counts(arm, joint, -node.drive.counts)
    node.drive.counts = 0
    node.on_nmt(NmtCommand.RESET_NODE)
    node.on_nmt(NmtCommand.START)


def _stop_watching(arm: VirtualController, joint: int) -> None:
    """Make a drive ignore the loss of the operator's heartbeat; its 1016h then reads 0."""
    arm.drives[joint - 1].answers[objects.HEARTBEAT_CONSUMER, 1] = 0
    _flag("ignores_heartbeat")(arm, joint)


def _freeze_sensor(arm: VirtualController, joint: int) -> None:
    arm.disturbances.frozen_counts[joint] = arm.drives[joint - 1].drive.counts


def _sensor_jump(arm: VirtualController, joint: int) -> None:
    lose_counts(arm, joint, arm.drives[joint - 1].axis.scale.to_counts(math.radians(2.0)))


def _diverge(arm: VirtualController, joint: int) -> None:
    """Make a joint move 5 deg away from its target; the drive reports no following error."""
    _flag("sees_no_following_error")(arm, joint)
    arm.disturbances.diverged_counts[joint] = 0


FAULT_KINDS: Mapping[str, FaultAction] = {
    "frames-lost": _frames(lost=0.01),
    "frames-lost-10": _frames(lost=0.1),
    "frames-doubled": _frames(doubled=0.1),
    "frames-reordered": _frames(swapped=0.1),
    "frames-late": _frames(late=0.05),
    "frames-flipped": _frames(flipped=0.01),
    "babbling": _frames(babble=5.0),
    "bus-flicker": _leave_bus(0.2),
    "bus-off": _leave_bus(3.0),
    "silent-node": _cut_cable,
    "silent-supervisor": lambda arm, _joint: _cut_cable(arm, objects.SUPERVISOR_NODE),
    "no-heartbeat": _add("no_heartbeat"),
    "other-heartbeat": _slow_heartbeat,
    "missed-answers": _set_of_joint("lost_tpdos", MISSED_ANSWERS),
    "double-answers": _add("doubled_tpdos"),
    "wrong-node": _swap_tpdo_id,
    "other-map": _report_speed,
    "sdo-stall": _add("stalled_sdo"),
    "sdo-stall-supervisor": lambda arm, _joint: arm.disturbances.stalled_sdo.add(
        objects.SUPERVISOR_NODE
    ),
    "sdo-abort": _add("refused_sdo"),
    "restart-node": _restart_node,
    "restart": lambda arm, _joint: arm.restart(),
    "hang": lambda arm, _joint: arm.running.clear(),
    "unwatched": _stop_watching,
    "lost-counts-5": partial(lose_counts, counts=-5),
    "lost-counts-500": partial(lose_counts, counts=-500),
    "sensor-jump": _sensor_jump,
    "ripple": _set_of_joint("ripple_counts", RIPPLE_COUNTS),
    "frozen-sensor": _freeze_sensor,
    "broken-sensor": _flag("sensor_failed"),
    "collision": lambda arm, joint: arm.drives[joint - 1].drive.trip(EmergencyCode.EXCESS_TORQUE),
    "blocked-joint": _add("blocked"),
    "sagging-drive": _add("sagging"),
    "slipped-fixture": lambda arm, _joint: arm.plant.slip(SLIP_M),
    "bound-hinge": lambda arm, _joint: arm.plant.bind_hinge(),
    "stray": _diverge,
    "lost-enable": _flag("loses_enable"),
    "deaf-drive": _flag("ignores_targets"),
    "emcy-storm": _add("storming"),
    "refused-modes": _flag("refuses_modes"),
    "external-stop": lambda arm, _joint: external_stop(arm, pressed=True),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptedFault:
    """A fault to inject at SYNC `at_sync`, before the plant's step; 0: before the first SYNC."""

    kind: str
    joint: int
    at_sync: int

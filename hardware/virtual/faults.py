"""Fault injection into the virtual controller, for tests and demonstrations.

Some of the faults that `fault_messages` describes are only a name in the node's set of active faults, which is read
where the fault has its effect. For the others, `FAULT_ACTIONS` has a function, which the controller's loop calls. A
`ScriptedFault` is injected at a given SYNC, so that a run with faults is reproducible.
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
from hardware.virtual.fault_messages import FAULTS

if TYPE_CHECKING:
    from hardware.virtual.controller import VirtualController
    from hardware.virtual.drive_node import DriveNode
    from hardware.virtual.node import VirtualNode

SLOW_HEARTBEAT_S = 5.0
MISSED_ANSWERS = 10
SLIP_M = 1e-3
JUMP_RAD = math.radians(2.0)

FaultAction = Callable[["VirtualController", "DriveNode"], object]
"""Function that injects a fault into the controller; only faults of one joint use the node."""


def inject(arm: VirtualController, kind: str, joint: int) -> None:
    """Inject the fault `kind` (`FAULTS`); may be called from any thread. Faults are injected in order of calls.

    Raises `KeyError` if there is no such fault, `ValueError` if there is no such joint.
    """
    if kind not in FAULTS:
        raise KeyError(kind)
    if not 1 <= joint <= len(arm.drives):
        raise ValueError(f"there is no joint {joint}")
    node = arm.drives[joint - 1]
    act = FAULT_ACTIONS.get(kind)
    arm.post(partial(node.faults.add, kind) if act is None else partial(act, arm, node))


def disturb_frames(arm: VirtualController, faults: FrameFaults) -> None:
    """Lose, double, delay or damage frames of all nodes, in both directions; `FrameFaults()` ends these faults."""
    arm.wire_out = FaultyWire(faults, 0, clock=arm.now_s)
    arm.wire_in = FaultyWire(faults, 1, clock=arm.now_s)


def lose_counts(node: DriveNode, counts: int) -> None:
    """Shift a joint's reading by `counts`, in addition to earlier shifts."""
    node.lost_counts += counts


def _frames(**shares: float) -> FaultAction:
    return lambda arm, _node: disturb_frames(arm, FrameFaults(**shares))


def _leave_bus(seconds: float) -> FaultAction:
    return lambda arm, _node: setattr(arm, "off_until_s", arm.now_s() + seconds)


def _cut_cable(arm: VirtualController, node: VirtualNode) -> None:
    arm.cut_since_s.setdefault(node.number, arm.now_s())


def _slow_heartbeat(_arm: VirtualController, node: DriveNode) -> None:
    node.answers[objects.HEARTBEAT_PRODUCER, 0] = round(SLOW_HEARTBEAT_S * 1e3)
    node.heartbeat_period_s = SLOW_HEARTBEAT_S


def _swap_tpdo_id(arm: VirtualController, node: DriveNode) -> None:
    """Make a joint send its TPDO1 with the identifier of the next joint; the last joint uses that of the first."""
    node.tpdo1_id = objects.COB_TPDO1 + node.number % len(arm.drives) + 1


def _report_speed(_arm: VirtualController, node: DriveNode) -> None:
    """Make TPDO1 carry the speed in place of the position; the PDO map (1A00h) states the speed too."""
    node.answers[objects.TPDO1_MAP, 2] = objects.VELOCITY_ACTUAL << 16 | 32
    node.reports_speed = True


def _restart_node(_arm: VirtualController, node: DriveNode) -> None:
    """Power-cycle one drive, which then becomes *operational* by itself; its position counts restart at zero."""
    lose_counts(node, -node.drive.counts)
    node.drive.counts = 0
    node.on_nmt(NmtCommand.RESET_NODE)
    node.on_nmt(NmtCommand.START)


def _stop_watching(_arm: VirtualController, node: DriveNode) -> None:
    """Make a drive ignore the loss of the operator's heartbeat; its 1016h then reads 0."""
    node.answers[objects.HEARTBEAT_CONSUMER, 1] = 0
    node.faults.add("unwatched")


def _external_stop(arm: VirtualController, _node: DriveNode) -> None:
    """Press the external stop: all drives trip (5441h) and block their valves."""
    for node in arm.drives:
        node.faults.add("external-stop")
        node.drive.trip(EmergencyCode.EXTERNAL_STOP)
    arm.supervisor.send_emergency([EmergencyCode.EXTERNAL_STOP])


FAULT_ACTIONS: Mapping[str, FaultAction] = {
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
    "silent-supervisor": lambda arm, _node: _cut_cable(arm, arm.supervisor),
    "other-heartbeat": _slow_heartbeat,
    "missed-answers": lambda _arm, node: setattr(node, "lost_tpdos", MISSED_ANSWERS),
    "wrong-node": _swap_tpdo_id,
    "other-map": _report_speed,
    "sdo-stall-supervisor": lambda arm, _node: arm.supervisor.faults.add("sdo-stall"),
    "restart-node": _restart_node,
    "restart": lambda arm, _node: arm.restart(),
    "hang": lambda arm, _node: arm.running.clear(),
    "unwatched": _stop_watching,
    "lost-counts-5": lambda _arm, node: lose_counts(node, -5),
    "lost-counts-500": lambda _arm, node: lose_counts(node, -500),
    "sensor-jump": lambda _arm, node: lose_counts(node, node.axis.scale.to_counts(JUMP_RAD)),
    "collision": lambda _arm, node: node.drive.trip(EmergencyCode.EXCESS_TORQUE),
    "slipped-fixture": lambda arm, _node: arm.plant.slip(SLIP_M),
    "bound-hinge": lambda arm, _node: arm.plant.bind_hinge(),
    "external-stop": _external_stop,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptedFault:
    """A fault to inject at SYNC `at_sync`, before the plant's step; 0: before the first SYNC."""

    kind: str
    joint: int
    at_sync: int

"""Fault injection into the virtual controller, for tests and demonstrations.

`FaultInjector` changes the controller's `hardware.virtual.disturbances` from any thread; a `ScriptedFault` does so
at a given SYNC, so that a run with faults is reproducible. `FAULT_KINDS` are the faults of `fault_messages` by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from hardware.canopen import objects
from hardware.canopen.objects import EmergencyCode, NmtCommand, joint_node
from hardware.virtual.disturbances import Disturbances, FaultyWire, FrameFaults
from hardware.virtual.drive_node import DriveNode

if TYPE_CHECKING:
    from hardware.virtual.controller import VirtualController

RIPPLE_COUNTS = 10.0
"""Standard deviation: ten times the noise of an RVDT's converter."""


class FaultInjector:
    """Injects and removes faults. Every call takes effect in the controller's loop, in order."""

    def __init__(self, controller: VirtualController) -> None:
        self._target = controller

    def disturb_frames(self, faults: FrameFaults) -> None:
        """Lose, double, delay or damage frames of all nodes, in both directions; `FrameFaults()` ends this."""

        def act(now: Disturbances) -> None:
            clean = faults == FrameFaults()
            clock = self._target.now_s
            now.wire_out = None if clean else FaultyWire(faults, 0, clock=clock)
            now.wire_in = None if clean else FaultyWire(faults, 1, clock=clock)

        self._disturb(act)

    def leave_bus(self, seconds: float) -> None:
        """Take all nodes of the arm off the bus for some time."""
        until = self._target.now_s
        self._disturb(lambda now: setattr(now, "off_until_s", until() + seconds))

    def silence(self, node: int) -> None:
        """Cut a node's cable: it neither sends nor receives."""
        self._disturb(lambda now: now.cut_since_s.setdefault(node, self._target.now_s()))

    def reconnect(self, node: int) -> None:
        """Reconnect the cable."""
        self._disturb(lambda now: now.cut_since_s.pop(node, None))

    def stop_heartbeat(self, node: int) -> None:
        """Stop a node's heartbeat; apart from that the node keeps working."""
        self._disturb(lambda now: now.no_heartbeat.add(node))

    def resume_heartbeat(self, node: int) -> None:
        """Resume the node's heartbeat."""
        self._disturb(lambda now: now.no_heartbeat.discard(node))

    def slow_heartbeat(self, joint: int, period_s: float) -> None:
        """Give a drive another heartbeat period, as 1017h then shows."""
        self.override_object(joint, objects.HEARTBEAT_PRODUCER, 0, round(period_s * 1e3))
        self._disturb(lambda now: now.heartbeat_period_s.update({joint: period_s}))

    def lose_tpdos(self, joint: int, count: int) -> None:
        """Lose the next `count` TPDO1 of a joint."""
        self._disturb(lambda now: now.lost_tpdos.update({joint: count}))

    def answer_twice(self, joint: int, *, twice: bool = True) -> None:
        """Let a joint answer every SYNC twice, as two drives with one number would."""
        self._drive(joint)
        self._disturb(
            lambda now: now.doubled_tpdos.add(joint) if twice else now.doubled_tpdos.discard(joint)
        )

    def swap_tpdo_id(self, joint: int) -> None:
        """Send a joint's TPDO1 with the identifier of the next joint (for the last joint, of the first)."""
        node, other = self._drive(joint), joint % len(self._target.drives) + 1
        wrong_id = objects.COB_TPDO1 + joint_node(other)
        self._target.post(lambda: setattr(node, "tpdo1_id", wrong_id))

    def report_speed(self, joint: int) -> None:
        """Map a drive's speed into TPDO1 in place of its position, as 1A00h then shows."""
        self.override_object(joint, objects.TPDO1_MAP, 2, objects.VELOCITY_ACTUAL << 16 | 32)
        self._on_node(joint, lambda node: setattr(node, "reports_speed", True))

    def stall_sdo(self, node: int) -> None:
        """Make a node answer no SDO request."""
        self._disturb(lambda now: now.stalled_sdo.add(node))

    def refuse_sdo(self, node: int) -> None:
        """Let a node abort every SDO request (08000000h)."""
        self._disturb(lambda now: now.refused_sdo.add(node))

    def override_object(self, joint: int, index: int, subindex: int, value: int) -> None:
        """Make an object of a drive read as `value`."""
        node = self._drive(joint)
        self._target.post(lambda: node.serve(index, subindex, lambda: value))

    def restart_node(self, joint: int) -> None:
        """Power-cycle one drive: it starts by itself, its counter at zero."""
        lost = self._target.disturbances.lost_counts

        def act(node: DriveNode) -> None:
            lost[joint] = lost.get(joint, 0) - node.drive.counts
            node.drive.counts = 0
            node.power_up()
            node.boot()
            node.on_nmt(NmtCommand.START)

        self._on_node(joint, act)

    def restart(self) -> None:
        """Power-cycle the whole controller."""
        self._target.post(self._target.restart)

    def hang(self) -> None:
        """Suspend the control loop: no answers, no heartbeats."""
        self._target.hang()

    def unhang(self) -> None:
        """Resume the control loop."""
        self._target.unhang()

    def stop_watching(self, joint: int) -> None:
        """Let a drive ignore the loss of the operator's heartbeat, as 1016h then shows."""
        self.override_object(joint, objects.HEARTBEAT_CONSUMER, 1, 0)
        self._set(joint, "ignores_heartbeat")

    def storm(self, joint: int) -> None:
        """Let a drive send emergencies on every SYNC."""
        self._drive(joint)
        self._disturb(lambda now: now.storming.add(joint))

    def freeze_sensor(self, joint: int) -> None:
        """Freeze a sensor's reading."""
        drive = self._drive(joint).drive
        self._disturb(lambda now: now.frozen_counts.update({joint: drive.counts}))

    def unfreeze_sensor(self, joint: int) -> None:
        """End the freeze of a sensor."""
        self._disturb(lambda now: now.frozen_counts.pop(joint, None))

    def break_sensor(self, joint: int, *, broken: bool = True) -> None:
        """Make the drive detect a failed sensor (7305h), or end that fault."""
        self._set(joint, "sensor_failed", value=broken)

    def lose_counts(self, joint: int, counts: int) -> None:
        """Shift a joint's reading by `counts` more."""
        self._drive(joint)
        self._disturb(
            lambda now: now.lost_counts.update({joint: now.lost_counts.get(joint, 0) + counts})
        )

    def jump(self, joint: int, angle_rad: float) -> None:
        """Shift a joint's reading by an angle, encoder or RVDT."""
        self.lose_counts(joint, self._drive(joint).axis.scale.to_counts(angle_rad))

    def ripple(self, joint: int) -> None:
        """Add noise of ten counts to a joint's reading, as from an unsteady supply."""
        self._drive(joint)
        self._disturb(lambda now: now.ripple_counts.update({joint: RIPPLE_COUNTS}))

    def trip(self, joint: int, code: EmergencyCode) -> None:
        """Trip a drive."""
        self._on_node(joint, lambda node: node.drive.trip(code))

    def block(self, joint: int) -> None:
        """Keep a joint from moving in free mode, like a valve that does not open."""
        self._drive(joint)
        self._disturb(lambda now: now.blocked.add(joint))

    def sag(self, joint: int) -> None:
        """Make a joint sag in position mode."""
        self._drive(joint)
        self._disturb(lambda now: now.sagging.add(joint))

    def diverge(self, joint: int) -> None:
        """Make a drive move 5 deg from its target without reporting a following error."""
        self._set(joint, "sees_no_following_error")
        self._disturb(lambda now: now.diverged_counts.update({joint: 0}))

    def lose_enable(self, joint: int) -> None:
        """Make a drive fall back to *switched on* once, as soon as it is enabled, without an emergency."""
        self._set(joint, "loses_enable")

    def ignore_targets(self, joint: int) -> None:
        """Keep a drive in position mode from moving, and make it report that it does not follow (bit 12)."""
        self._set(joint, "ignores_targets")

    def refuse_modes(self, joint: int, *, refuse: bool = True) -> None:
        """Keep 6061h as it is, whatever 6060h requests."""
        self._set(joint, "refuses_modes", value=refuse)

    def slip_fixture(self, slip_m: float) -> None:
        """Shift the fixture along its x axis."""
        self._target.post(lambda: self._target.plant.slip(slip_m))

    def bind_hinge(self) -> None:
        """Block the hinge."""
        self._target.post(self._target.plant.bind_hinge)

    def external_stop(self, *, pressed: bool = True) -> None:
        """Press or release the external stop: all drives trip, valves blocked (5441h)."""
        target = self._target

        def act() -> None:
            for node in target.drives:
                with node.lock:
                    node.drive.external_stop = pressed
                    if pressed:
                        node.drive.trip(EmergencyCode.EXTERNAL_STOP)
            target.supervisor.external_stop(active=pressed)

        target.post(act)

    def _disturb(self, act: Callable[[Disturbances], object]) -> None:
        """Change the disturbances in the control loop."""

        def apply() -> None:
            act(self._target.disturbances)

        self._target.post(apply)

    def _on_node(self, joint: int, act: Callable[[DriveNode], None]) -> None:
        """Act on a drive's node in the control loop, under its lock."""
        node = self._drive(joint)

        def locked() -> None:
            with node.lock:
                act(node)

        self._target.post(locked)

    def _set(self, joint: int, flag: str, *, value: bool = True) -> None:
        """Set a flag of a joint's `Drive`."""
        self._on_node(joint, lambda node: setattr(node.drive, flag, value))

    def _drive(self, joint: int) -> DriveNode:
        if not 1 <= joint <= len(self._target.drives):
            raise ValueError(f"there is no joint {joint}")
        return self._target.drives[joint - 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptedFault:
    """A fault at a SYNC, before the plant's step; SYNCs count from 1, and 0 is before the first."""

    at_sync: int
    happen: Callable[[FaultInjector], None]


FaultAction = Callable[[FaultInjector, int], None]
"""Injects a fault; the number is that of the joint, for faults of one joint."""


def _frames(**shares: float) -> FaultAction:
    return lambda faults, _joint: faults.disturb_frames(FrameFaults(**shares))


FAULT_KINDS: Mapping[str, FaultAction] = MappingProxyType(
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
        "silent-supervisor": lambda faults, _joint: faults.silence(objects.SUPERVISOR_NODE),
        "no-heartbeat": FaultInjector.stop_heartbeat,
        "other-heartbeat": lambda faults, joint: faults.slow_heartbeat(joint, 5.0),
        "missed-answers": lambda faults, joint: faults.lose_tpdos(joint, 10),
        "double-answers": FaultInjector.answer_twice,
        "wrong-node": FaultInjector.swap_tpdo_id,
        "other-map": FaultInjector.report_speed,
        "sdo-stall": FaultInjector.stall_sdo,
        "sdo-stall-supervisor": lambda faults, _joint: faults.stall_sdo(objects.SUPERVISOR_NODE),
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
        "stray": FaultInjector.diverge,
        "lost-enable": FaultInjector.lose_enable,
        "deaf-drive": FaultInjector.ignore_targets,
        "emcy-storm": FaultInjector.storm,
        "refused-modes": FaultInjector.refuse_modes,
        "external-stop": lambda faults, _joint: faults.external_stop(),
    }
)


def scripted(kind: str, *, joint: int, at_sync: int) -> ScriptedFault:
    """The fault of this name at a SYNC; KeyError if there is none."""
    happen = FAULT_KINDS[kind]
    return ScriptedFault(at_sync=at_sync, happen=lambda faults: happen(faults, joint))

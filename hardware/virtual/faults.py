"""Things that go wrong on purpose, for tests and demonstrations. Knows the virtual controller only.

`FaultInjector` changes what the controller looks at on every SYNC (`hardware.virtual.disturbances`), from
any thread; a `ScriptedFault` does so at a given SYNC, so that a run with faults is repeatable too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from hardware.canopen.objects import (
    COB_TPDO1,
    HEARTBEAT_CONSUMER,
    HEARTBEAT_PRODUCER,
    TPDO1_MAP,
    VELOCITY_ACTUAL,
    EmergencyCode,
    NmtCommand,
    joint_node,
)
from hardware.virtual.disturbances import Disturbances
from hardware.virtual.drive_node import DriveNode
from hardware.virtual.frame_faults import FaultyWire, FrameFaults
from hardware.virtual.port import FixturePort, PlantPort
from hardware.virtual.supervisor_node import SupervisorNode

RIPPLE_COUNTS = 10.0
"""Ten times what an RVDT's converter has by itself."""


class Victim(Protocol):
    """What can be disturbed: the virtual controller."""

    disturbances: Disturbances
    drives: tuple[DriveNode, ...]
    supervisor: SupervisorNode
    plant: PlantPort

    def post(self, action: Callable[[], None]) -> None:
        """Run something in the control loop, soon."""
        ...

    def now_s(self) -> float:
        """The controller's clock."""
        ...

    def restart(self) -> None:
        """Take mains away from all nodes and give it back; in the control loop."""
        ...

    def hang(self) -> None:
        """Let the control loop hang until `unhang`."""
        ...

    def unhang(self) -> None:
        """Let it go on."""
        ...


class FaultInjector:
    """Breaks and mends a virtual controller. Every call takes effect in its control loop, in order."""

    def __init__(self, controller: Victim) -> None:
        self._victim = controller

    def silence(self, node: int) -> None:
        """Cut a node's cable: it neither sends nor hears."""
        victim = self._victim

        def act() -> None:
            victim.disturbances.cut_since_s.setdefault(node, victim.now_s())

        victim.post(act)

    def reconnect(self, node: int) -> None:
        """Mend the cable."""
        victim = self._victim
        victim.post(lambda: _forget(victim.disturbances.cut_since_s, node))

    def stop_heartbeat(self, node: int) -> None:
        """Let a node work on without heartbeats."""
        self._victim.post(lambda: self._victim.disturbances.no_heartbeat.add(node))

    def resume_heartbeat(self, node: int) -> None:
        """Let the node's heartbeats go on."""
        self._victim.post(lambda: self._victim.disturbances.no_heartbeat.discard(node))

    def lose_tpdos(self, joint: int, count: int) -> None:
        """Lose the next `count` TPDO1 of a joint."""
        self._victim.post(lambda: self._victim.disturbances.lost_tpdos.update({joint: count}))

    def freeze_sensor(self, joint: int) -> None:
        """Let a sensor report what it reports now, for good."""
        drive = self._drive(joint).drive
        frozen = self._victim.disturbances.frozen_counts
        self._victim.post(lambda: frozen.update({joint: drive.counts}))

    def thaw_sensor(self, joint: int) -> None:
        """Mend a frozen sensor."""
        self._victim.post(lambda: _forget(self._victim.disturbances.frozen_counts, joint))

    def disturb_frames(self, faults: FrameFaults) -> None:
        """Let frames of all nodes and frames for them get lost, come twice, ...; no faults mend the wire."""
        victim = self._victim

        def act() -> None:
            sound = faults == FrameFaults()
            wrong = victim.disturbances
            wrong.wire_out = None if sound else FaultyWire(faults, 0, clock=victim.now_s)
            wrong.wire_in = None if sound else FaultyWire(faults, 1, clock=victim.now_s)

        victim.post(act)

    def leave_bus(self, seconds: float) -> None:
        """Be off the bus, all nodes of the arm, and come back by itself."""
        victim = self._victim

        def act() -> None:
            victim.disturbances.off_until_s = victim.now_s() + seconds

        victim.post(act)

    def stall_sdo(self, node: int) -> None:
        """Let a node answer no object access any more."""
        self._victim.post(lambda: self._victim.disturbances.stalled_sdo.add(node))

    def refuse_sdo(self, node: int) -> None:
        """Let a node refuse every object access (08000000h)."""
        self._victim.post(lambda: self._victim.disturbances.refused_sdo.add(node))

    def set_up_otherwise(self, joint: int, index: int, subindex: int, value: int) -> None:
        """Let an object of a drive read as somebody else has set it up."""
        node = self._drive(joint)
        self._victim.post(lambda: node.serve(index, subindex, lambda: value))

    def report_speed(self, joint: int) -> None:
        """Let a drive's TPDO1 carry its speed where its position belongs, and 1A00h say so."""
        node = self._drive(joint)

        def act() -> None:
            with node.lock:
                node.reports_speed = True

        self.set_up_otherwise(joint, TPDO1_MAP, 2, VELOCITY_ACTUAL << 16 | 32)
        self._victim.post(act)

    def beat_seldom(self, joint: int, period_s: float) -> None:
        """Let a drive send a heartbeat every so often only, and 1017h say so."""
        periods = self._victim.disturbances.heartbeat_period_s
        self.set_up_otherwise(joint, HEARTBEAT_PRODUCER, 0, round(period_s * 1e3))
        self._victim.post(lambda: periods.update({joint: period_s}))

    def answer_as_another(self, joint: int) -> None:
        """Let a joint's TPDO1 come with the identifier of the next one's, the last one's with the first's."""
        node, other = self._drive(joint), joint % len(self._victim.drives) + 1
        wrong_id = COB_TPDO1 + joint_node(other)
        self._victim.post(lambda: setattr(node, "tpdo1_id", wrong_id))

    def jump(self, joint: int, angle_rad: float) -> None:
        """Let a joint's sensor be off by so much more, whichever sensor it is."""
        self.lose_counts(joint, self._drive(joint).axis.scale.to_counts(angle_rad))

    def ripple(self, joint: int) -> None:
        """Let a joint's sensor have noise of ten counts beside its own, as of an unsteady supply."""
        self._drive(joint)
        ripple = self._victim.disturbances.ripple_counts
        self._victim.post(lambda: ripple.update({joint: RIPPLE_COUNTS}))

    def block(self, joint: int) -> None:
        """Let a joint stay where it is whenever it should be free: a valve that does not open."""
        self._drive(joint)
        self._victim.post(lambda: self._victim.disturbances.blocked.add(joint))

    def sag(self, joint: int) -> None:
        """Let a joint hold nothing whenever it should be in position mode."""
        self._drive(joint)
        self._victim.post(lambda: self._victim.disturbances.sagging.add(joint))

    def slip_fixture(self, slip_m: float) -> None:
        """Let what holds the hand stand so much further along its x from now on."""
        self._victim.post(lambda: self._loop().slip(slip_m))

    def bind_hinge(self) -> None:
        """Let the hinge turn no more."""
        self._victim.post(lambda: self._loop().bind_hinge())

    def stop_watching(self, joint: int) -> None:
        """Let a drive go on when the operator's heartbeat is lost, and 1016h say that it does."""
        node = self._drive(joint)

        def act() -> None:
            with node.lock:
                node.drive.ignores_heartbeat = True

        self.set_up_otherwise(joint, HEARTBEAT_CONSUMER, 1, 0)
        self._victim.post(act)

    def storm(self, joint: int) -> None:
        """Let a drive send emergencies without end."""
        self._drive(joint)
        self._victim.post(lambda: self._victim.disturbances.storming.add(joint))

    def go_astray(self, joint: int) -> None:
        """Let a drive go 5 deg from where it is told to be, without noticing it."""
        node = self._drive(joint)
        astray = self._victim.disturbances.astray_counts

        def act() -> None:
            astray[joint] = 0
            with node.lock:
                node.drive.sees_no_following_error = True

        self._victim.post(act)

    def lose_enable(self, joint: int) -> None:
        """Let a drive fall back to *switched on* once, as soon as it is enabled, and say nothing of it."""
        self._set(joint, "loses_enable")

    def ignore_targets(self, joint: int) -> None:
        """Let a drive stay where it is in position mode, and say that it does not follow (bit 12)."""
        self._set(joint, "ignores_targets")

    def trip(self, joint: int, code: EmergencyCode) -> None:
        """Let a drive trip."""
        node = self._drive(joint)

        def act() -> None:
            with node.lock:
                node.drive.trip(code)

        self._victim.post(act)

    def lose_counts(self, joint: int, counts: int) -> None:
        """Let a joint's sensor be off by so many counts more, from one SYNC to the next."""
        self._drive(joint)
        lost = self._victim.disturbances.lost_counts
        self._victim.post(lambda: lost.update({joint: lost.get(joint, 0) + counts}))

    def answer_twice(self, joint: int, *, twice: bool = True) -> None:
        """Let a joint answer every SYNC twice, as two drives with one number would."""
        self._drive(joint)
        doubled = self._victim.disturbances.doubled_tpdos
        self._victim.post(lambda: doubled.add(joint) if twice else doubled.discard(joint))

    def restart_node(self, joint: int) -> None:
        """Take mains away from one drive and give it back: it starts by itself, its counter at zero."""
        node, victim = self._drive(joint), self._victim

        def act() -> None:
            lost = victim.disturbances.lost_counts
            with node.lock:
                lost[joint] = lost.get(joint, 0) - node.drive.counts
                node.drive.counts = 0
                node.power_up()
                node.boot()
                node.on_nmt(NmtCommand.START)

        victim.post(act)

    def break_sensor(self, joint: int, *, broken: bool = True) -> None:
        """Let the drive see that its sensor has failed (7305h), or mend it."""
        node = self._drive(joint)

        def act() -> None:
            with node.lock:
                node.drive.sensor_failed = broken

        self._victim.post(act)

    def refuse_modes(self, joint: int, *, refuse: bool = True) -> None:
        """Let 6061h stay what it is whatever 6060h asks for."""
        node = self._drive(joint)

        def act() -> None:
            with node.lock:
                node.drive.refuses_modes = refuse

        self._victim.post(act)

    def external_stop(self, *, pressed: bool = True) -> None:
        """Press or release the external stop: all drives trip, valves blocked (5441h)."""
        victim = self._victim

        def act() -> None:
            for node in victim.drives:
                with node.lock:
                    node.drive.external_stop = pressed
                    if pressed:
                        node.drive.trip(EmergencyCode.EXTERNAL_STOP)
            victim.supervisor.external_stop(active=pressed)

        victim.post(act)

    def restart(self) -> None:
        """Take mains away from the whole controller and give it back."""
        self._victim.post(self._victim.restart)

    def hang(self) -> None:
        """Let the control loop hang: no answers, no heartbeats."""
        self._victim.hang()

    def unhang(self) -> None:
        """Let the control loop go on."""
        self._victim.unhang()

    def _set(self, joint: int, flaw: str) -> None:
        node = self._drive(joint)

        def act() -> None:
            with node.lock:
                setattr(node.drive, flaw, True)

        self._victim.post(act)

    def _loop(self) -> FixturePort:
        plant = self._victim.plant
        if not isinstance(plant, FixturePort):
            raise TypeError("this plant has no fixture that could slip or bind")
        return plant

    def _drive(self, joint: int) -> DriveNode:
        if not 1 <= joint <= len(self._victim.drives):
            raise ValueError(f"there is no joint {joint}")
        return self._victim.drives[joint - 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptedFault:
    """Something that happens at a SYNC, before the plant moves on; SYNCs count from 1, 0 is before the first."""

    at_sync: int
    happen: Callable[[FaultInjector], None]


def _forget(mapping: dict[int, Any], key: int) -> None:
    mapping.pop(key, None)

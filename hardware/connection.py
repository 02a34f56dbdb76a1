"""A connection to the arm on the bus: opened, checked, running; closed again. Knows no motion.

Order: listen for another operator before a single frame is sent; reset the nodes' communication and
wait for every boot-up; compare the arm with its description; heartbeat; NMT start; SYNC.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import can

from hardware import identifying, steps
from hardware.acceptance import operator_filters
from hardware.admission import admit
from hardware.arm import ArmIdentity, ArmSnapshot, DriveState, JointMode
from hardware.buses import BusSettings, open_bus, open_sender
from hardware.continuity import ENCODER_COUNTS, RVDT_COUNTS
from hardware.control_loop import ControlLoop, Pace, Timing
from hardware.cyclic import Sample, Setpoints
from hardware.description import ArmDescription, EncoderDescription
from hardware.errors import BusError, ControlDenied, DriveFault, NodeMissing, Stopped, TwoDevices
from hardware.limits import joint_limits
from hardware.mapping import check_mapping, check_positions, patience_s
from hardware.objects import (
    COB_NMT,
    ERROR_CODE,
    JOINT_MODE,
    MODE_DISPLAY,
    OPERATOR_NODE,
    SUPERVISOR_NODE,
    TOKEN,
    NmtCommand,
    NmtState,
    joint_node,
)
from hardware.sdo import ObjectAccess
from hardware.snapshots import build_snapshot
from hardware.stop_line import StopLine
from hardware.wire import Wire

LISTEN_S: Final = 0.35
"""Three heartbeats of another operator fit in here."""
BOOT_TIMEOUT_S: Final = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BusOpeners:
    """How the two handles on a bus are opened."""

    main: Callable[[BusSettings], can.BusABC] = open_bus
    stop: Callable[[BusSettings], can.BusABC] = open_sender


class Connection:
    """An open connection; made by `connect`.

    Attributes
    ----------
    loop, access, stop_line
        Cyclic traffic, object access, STOP.
    limits, scales
        Of joints 1..n.
    modes
        What 6061h of each drive said when it was last read; None for neither position nor free.
    token
        Holder of the control token, as last read or written.
    """

    def __init__(
        self,
        description: ArmDescription,
        settings: BusSettings,
        *,
        pace: Pace,
        timing: Timing,
        openers: BusOpeners,
        record_to: Path | None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        joints = self.joints = len(description.joints)
        self._description, self._timing, self._clock = description, timing, clock
        self.scales = tuple(joint.scale for joint in description.joints)
        self.limits = tuple(
            joint_limits(
                number,
                joint.scale,
                lower_rad=joint.lower_rad,
                upper_rad=joint.upper_rad,
                max_speed_rad_per_s=joint.max_speed_rad_per_s,
                period_s=timing.period_s,
            )
            for number, joint in enumerate(description.joints, 1)
        )
        self.modes: tuple[JointMode | None, ...] = (None,) * joints
        self.token = 0
        self._rated_nm: tuple[float, ...] = (0.0,) * joints
        bus = openers.main(settings)
        if record_to is None:  # a recording is of everything
            bus.set_filters(operator_filters(joints))
        self._wire = Wire(bus, record_to=record_to)
        try:
            self.stop_line = StopLine(self._second_handle(openers, settings), self._wire)
        except BaseException:
            self._wire.close()
            raise
        nodes = (*(joint_node(j) for j in range(1, joints + 1)), SUPERVISOR_NODE)
        self.access = ObjectAccess(self._wire.send, nodes, timeout_s=timing.sdo_timeout_s)
        self.loop = ControlLoop(
            self._wire,
            joints=joints,
            pace=pace,
            on_sdo=self.access.deliver,
            allow=self._allow,
            quick_stop=self.send_quick_stops,
            timing=timing,
            allowed_counts=[
                ENCODER_COUNTS if isinstance(joint.sensor, EncoderDescription) else RVDT_COUNTS
                for joint in description.joints
            ],
            clock=clock,
        )

    @staticmethod
    def _second_handle(openers: BusOpeners, settings: BusSettings) -> can.BusABC | None:
        """Open the handle for STOP; None where the adapter, open already, does not open twice."""
        try:
            return openers.stop(settings)
        except BusError:
            return None

    def open(self) -> ArmIdentity:
        """Find the nodes, check them, start heartbeat and SYNC.

        Raises
        ------
        ControlDenied, NodeMissing, WrongArm, MappingDiffers, BusError, SdoRefused
        """
        loop, wire, access = self.loop, self._wire, self.access
        loop.start()
        if loop.nodes.wait_for_other_operator(LISTEN_S):
            raise ControlDenied(OPERATOR_NODE)
        loop.nodes.expect_boot_up()
        wire.send(COB_NMT, bytes([NmtCommand.RESET_COMMUNICATION, 0]))
        _require(loop.nodes.wait_for_boot_up(BOOT_TIMEOUT_S))
        identity = identifying.read_identity(access, self.joints)
        self._require_single()
        identifying.check_arm(access, identity, self._description, period_s=self._timing.period_s)
        check_mapping(access, self.joints)
        self._require_single()
        loop.heartbeat_timeout_s = patience_s(
            access, (*range(1, self.joints + 1), SUPERVISOR_NODE), loop.heartbeat_timeout_s
        )
        self._rated_nm = identifying.read_rated_torques_nm(access, self.joints)
        loop.begin_heartbeat()
        wire.send(COB_NMT, bytes([NmtCommand.START, 0]))
        _require(loop.nodes.wait_for_state(NmtState.OPERATIONAL, BOOT_TIMEOUT_S))
        self.token = access.read_unsigned(SUPERVISOR_NODE, TOKEN)
        loop.begin_sync()
        first = loop.run(steps.look_until_whole(loop), despite=(DriveFault, Stopped))
        check_positions(access, first.counts, self.scales)
        self._learn_of_trips(first)
        self.read_modes()
        return identity

    def _require_single(self) -> None:
        twice = self.access.answering_twice()
        if twice:
            raise TwoDevices(twice)

    def _learn_of_trips(self, first: Sample) -> None:
        """Ask drives that are in a fault why (603Fh): their emergencies were sent before we listened."""
        codes = {
            joint: self.access.read_unsigned(joint_node(joint), ERROR_CODE)
            for joint, status in enumerate(first.statuswords, 1)
            if steps.state_of(status) in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
        }
        nodes = self.loop.nodes

        def note() -> Generator[Setpoints | None, Sample, None]:
            for joint, code in codes.items():
                nodes.assume_fault(joint_node(joint), code, first.sync_count)
            yield from ()

        self.loop.run(note())

    def close(self) -> None:
        """End everything that is sent and the recording."""
        self.loop.close()
        self.stop_line.close()
        self._wire.close()

    @property
    def recording_failure(self) -> str | None:
        """Why the recording of the bus ended early, None if it did not."""
        return self._wire.recording_failure

    @property
    def in_control(self) -> bool:
        """Whether the control token is ours."""
        return self.token == OPERATOR_NODE

    def other_operator(self) -> bool:
        """Whether another operator's heartbeat is on the bus."""
        return self.loop.nodes.other_operator(
            self.loop.attention.listened_s, self._timing.heartbeat_timeout_s
        )

    def deserted(self) -> bool:
        """Whether nobody answers any more: the bus is gone, or a node has fallen silent."""
        loop = self.loop
        return loop.failure is not None or bool(
            loop.nodes.silent(loop.attention.listened_s, loop.heartbeat_timeout_s)
        )

    def read_modes(self) -> None:
        """Read 6061h of every drive."""
        self.modes = tuple(
            JOINT_MODE.get(self.access.read_signed(joint_node(j), MODE_DISPLAY))
            for j in range(1, self.joints + 1)
        )

    def send_quick_stops(self) -> None:
        """Quick stop to all drives now."""
        self.stop_line.send(self.loop.commands, self.loop.view.sample.counts)

    def snapshot(self) -> ArmSnapshot:
        """The latest state; never blocks."""
        return build_snapshot(
            self.loop.view,
            self.loop.nodes,
            scales=self.scales,
            rated_torques_nm=self._rated_nm,
            modes=self.modes,
            token=self.token,
            stopped=self.loop.stop_latched,
            moving=self.loop.moving,
            period_s=self._timing.period_s,
            now_s=self._clock(),
            attention=self.loop.attention,
        )

    def _allow(self, sample: Sample, before: Setpoints | None, commands: Setpoints) -> None:
        admit(
            self.limits,
            self.modes,
            in_control=self.in_control,
            stopped=self.loop.stop_latched,
            sample=sample,
            before=before,
            commands=commands,
        )


def _require(missing: tuple[int, ...]) -> None:
    if missing:
        raise NodeMissing(missing)

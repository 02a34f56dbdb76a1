"""A connection to the arm on the bus: opened, checked, running; closed again. Knows no motion.

Order: listen for another operator or master before a single frame is sent; reset the communication of the
arm's nodes (and of nothing else on the bus) and wait for every boot-up; compare the arm with its description;
heartbeat; NMT start; SYNC.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import can

from hardware import identifying, steps, uploading
from hardware.acceptance import operator_filters
from hardware.admission import admit
from hardware.arm import ArmIdentity, ArmSnapshot, DriveState, JointMode
from hardware.buses import BusSettings, open_bus, open_sender
from hardware.continuity import ENCODER_COUNTS, RVDT_COUNTS
from hardware.control_loop import ControlLoop
from hardware.cyclic import Sample, Setpoints, frames_of
from hardware.description import ArmDescription, EncoderDescription
from hardware.errors import (
    BusError,
    ControlDenied,
    DriveFault,
    Intruder,
    NodeMissing,
    SdoRefused,
    Stopped,
    TwoDevices,
)
from hardware.following import Following
from hardware.mapping import check_mapping, check_positions
from hardware.objects import (
    COB_NMT,
    ERROR_CODE,
    MODE_DISPLAY,
    OPERATOR_NODE,
    TOKEN,
    NmtCommand,
    NmtState,
)
from hardware.profile import BusProfile
from hardware.sdo import ObjectAccess
from hardware.snapshots import build_snapshot
from hardware.stop_line import StopLine
from hardware.supervision import check_watch, following_windows_counts, patience_s
from hardware.timing import Pace, Timing
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
        Holder of the control token, as last read or written; of an arm without a supervisor, whether this
        program has taken control.
    """

    def __init__(
        self,
        description: ArmDescription,
        settings: BusSettings,
        profile: BusProfile,
        *,
        pace: Pace,
        timing: Timing,
        openers: BusOpeners,
        record_to: Path | None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.profile = profile
        self._description, self._timing, self._clock = description, timing, clock
        self.scales = tuple(
            identifying.scale_of(joint, drive)
            for joint, drive in zip(description.joints, profile.joints, strict=True)
        )
        self.limits = identifying.limits_of(description, profile, period_s=timing.period_s)
        self.modes: tuple[JointMode | None, ...] = (None,) * len(profile.joints)
        self.token = 0
        self._rated_nm: tuple[float, ...] = (0.0,) * len(profile.joints)
        bus = openers.main(settings)
        if record_to is None:  # a recording is of everything
            bus.set_filters(operator_filters(profile))
        self._wire = Wire(bus, record_to=record_to)
        try:
            self.stop_line = StopLine(
                self._second_handle(openers, settings), self._wire, frames_of(profile)
            )
        except BaseException:
            self._wire.close()
            raise
        self.access = ObjectAccess(self._wire.send, profile.nodes, timeout_s=timing.sdo_timeout_s)
        self.loop = ControlLoop(
            self._wire,
            profile=profile,
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

    def open(self, press: object | None = None) -> ArmIdentity:
        """Find the nodes, check them, start heartbeat and SYNC.

        `press` is the last STOP before; a newer one ends this.

        Raises
        ------
        Stopped, ControlDenied, Intruder, NodeMissing, WrongArm, MappingDiffers, BusError, SdoRefused
        """
        loop, access, profile = self.loop, self.access, self.profile
        loop.nodes.given_up = lambda: loop.latch.last is not press
        loop.start()
        if loop.nodes.wait_for_other_operator(LISTEN_S):
            raise ControlDenied(OPERATOR_NODE)
        self._go_on()
        if loop.nodes.intrusion:
            raise Intruder(
                f"Somebody else works on this bus: {loop.nodes.intrusion} came from another program. Nothing "
                "was sent to the arm. End that program, or take its device off this bus, then connect again; "
                "`sarcal monitor` shows what it sends."
            )
        loop.nodes.expect_boot_up()
        self._command_nodes(NmtCommand.RESET_COMMUNICATION)
        missing = loop.nodes.wait_for_boot_up(BOOT_TIMEOUT_S)
        self._go_on()
        if missing:
            # Of an arm that is set up in another way some nodes may well be there: say all of it.
            check_mapping(access, profile, missing)
        _require(missing)
        identity = identifying.read_identity(access, profile, self._description)
        self._require_single()
        self._go_on()
        check_mapping(access, profile)
        self._go_on()
        identifying.check_arm(
            access, identity, self._description, profile, period_s=self._timing.period_s
        )
        self._require_single()
        loop.heartbeat_timeout_s = patience_s(access, profile, loop.heartbeat_timeout_s)
        identity = replace(identity, unwatching=check_watch(access, profile))
        loop.following = Following(following_windows_counts(access, profile, self.scales))
        self._rated_nm = identifying.read_rated_torques_nm(access, profile)
        self._go_on()
        loop.begin_heartbeat()
        self._command_nodes(NmtCommand.START)
        waiting = loop.nodes.wait_for_state(NmtState.OPERATIONAL, BOOT_TIMEOUT_S)
        self._go_on()
        _require(waiting)
        if profile.supervisor is not None:
            self.token = access.read_unsigned(profile.supervisor, TOKEN)
        loop.begin_sync()
        first = loop.run(steps.look_until_whole(loop), despite=(DriveFault, Stopped))
        check_positions(access, profile, first.counts, self.scales)
        self._learn_of_trips(first)
        self.read_modes()
        self._go_on()
        return identity

    def _go_on(self) -> None:
        """Raise if STOP was pressed since this began: nothing was enabled, and nothing will be."""
        if self.loop.nodes.given_up():
            raise Stopped(
                "STOP was pressed while connecting, and stays latched: nothing was enabled, and the connection "
                "is closed. Connect again first"
            )

    def _command_nodes(self, command: NmtCommand) -> None:
        """Send an NMT command to the arm's nodes, one by one: what else is on this bus is not ours to reset."""
        for node in self.profile.nodes:
            self._wire.send(COB_NMT, bytes([command, node]))

    def _require_single(self) -> None:
        twice = self.access.answering_twice()
        if twice:
            raise TwoDevices(twice)

    def _learn_of_trips(self, first: Sample) -> None:
        """Ask drives that are in a fault why (603Fh): their emergencies were sent before we listened."""
        codes = {
            node: self.access.read_unsigned(node, ERROR_CODE)
            for node, status in zip(self.profile.drives, first.statuswords, strict=True)
            if steps.state_of(status) in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
        }
        nodes = self.loop.nodes

        def note() -> Generator[Setpoints | None, Sample, None]:
            for node, code in codes.items():
                nodes.assume_fault(node, code, first.sync_count)
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
            self.profile.mode_of(self.access.read_signed(node, MODE_DISPLAY))
            for node in self.profile.drives
        )

    def take_token(self) -> None:
        """Have control given to this program by the supervisor; without one nobody else can have it.

        Raises
        ------
        ControlDenied
        """
        supervisor = self.profile.supervisor
        if supervisor is not None:
            try:
                self.access.write_unsigned(supervisor, TOKEN, 0, OPERATOR_NODE, 4)
            except SdoRefused as refused:
                self.token = self.access.read_unsigned(supervisor, TOKEN)
                words = uploading.refusal(self.access, supervisor)
                raise ControlDenied(self.token, words) from refused
        self.token = OPERATOR_NODE

    def give_token_back(self) -> None:
        """Let others have control."""
        if self.profile.supervisor is not None:
            self.access.write_unsigned(self.profile.supervisor, TOKEN, 0, 0, 4)
        self.token = 0

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

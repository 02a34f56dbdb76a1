"""Bringing the nodes of an arm up, so that they run and are known to be the ones expected. Knows no motion.

Order: listen for another operator or master before a single frame is sent; ask drives and supervisor whether
somebody works with them; reset the communication of the arm's nodes (and of nothing else on the bus) and wait
for every boot-up; compare the arm with its description;
heartbeat; NMT start; SYNC.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from hardware.arm import ArmIdentity, DriveState
from hardware.bus_setup import ArmOnBus
from hardware.canopen import identifying
from hardware.canopen.cia402 import state_of
from hardware.canopen.configuring import configure, zero_residual_torques
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.canopen.maps import check_communication, check_mapping, check_positions
from hardware.canopen.objects import (
    COB_NMT,
    ERROR_CODE,
    OPERATOR_NODE,
    TOKEN,
    NmtCommand,
    NmtState,
)
from hardware.canopen.sdo import ObjectAccess
from hardware.canopen.supervision import (
    check_operator_monitoring,
    following_windows_counts,
    heartbeat_timeout_s,
)
from hardware.control import in_use, steps
from hardware.control.control_loop import ControlLoop
from hardware.errors import (
    BusError,
    ControlDenied,
    DriveDiverged,
    DriveFault,
    DuplicateNodeId,
    HardwareError,
    NodeMissing,
    OtherMaster,
    Stopped,
)
from hardware.scale import JointScale
from hardware.timing import Pace


@dataclass(frozen=True, slots=True, kw_only=True)
class Started:
    """What was learned on the way; `token` is the holder of the control token, 0 for nobody."""

    identity: ArmIdentity
    rated_torques_nm: tuple[float, ...]
    token: int


class StartUp:
    """One start-up of the nodes of an arm.

    Parameters
    ----------
    on_bus
        The arm expected.
    loop, access, send
        Cyclic traffic, object access, and what puts a frame on the bus.
    scales
        Of joints 1..n.
    listen_s
        How long to listen for others before anything is sent.
    boot_timeout_s
        How long a node may take to boot, and to start.
    """

    def __init__(
        self,
        on_bus: ArmOnBus,
        *,
        loop: ControlLoop,
        access: ObjectAccess,
        send: Callable[[int, bytes], None],
        scales: Sequence[JointScale],
        listen_s: float,
        boot_timeout_s: float,
    ) -> None:
        self._description, self._profile = on_bus.description, on_bus.profile
        self._period_s = on_bus.timing.period_s
        # In fast forward no time passes for the drives, and nobody else has that arm.
        self._shared = on_bus.pace is Pace.REAL_TIME
        self._loop, self._access, self._send, self._scales = loop, access, send, tuple(scales)
        self._listen_s, self._boot_timeout_s = listen_s, boot_timeout_s
        self._configured: tuple[str, ...] = ()
        self._zeroed: list[str] = []
        self._pressed: Callable[[], bool] = lambda: False

    def run(self, press: object | None, *, takes_over: bool) -> Started:
        """Find the nodes, check them, start heartbeat and SYNC; a STOP newer than `press` ends this.

        `takes_over`: see `in_use.require_unused`.
        """
        loop, access, profile = self._loop, self._access, self._profile
        self._pressed = lambda: loop.latch.last_press is not press
        loop.nodes.cancelled = lambda: self._pressed() or loop.failure is not None
        loop.start()
        self._listen(self._listen_s)
        if self._shared:
            in_use.require_unused(access, loop.nodes, self._listen, takes_over=takes_over)
            self._listen(0.0)  # who commanded while the nodes were asked, before that is forgotten
        loop.nodes.expect_boot_up()
        missing = self._told(NmtCommand.RESET_COMMUNICATION, loop.nodes.wait_for_boot_up)
        loop.nodes.expect_no_boot_up()
        if missing and not profile.configures_pdos:
            # Of an arm that is set up in another way some nodes may well be there: say all of it.
            check_mapping(access, profile, missing)
        _require(missing)
        identity = identifying.read_identity(access, profile, self._description)
        self._require_single()
        self.go_on()
        identity, rated_torques_nm = self._check_drives(identity)
        self._require_single()
        for words in zero_residual_torques(access, profile):
            self._zeroed.append(words)
        zeroed = tuple(self._zeroed)
        identity = replace(identity, configured=(*self._configured, *zeroed), zeroed=zeroed)
        self.go_on()
        loop.begin_heartbeat()
        _require(
            self._told(NmtCommand.START, partial(loop.nodes.wait_for_state, NmtState.OPERATIONAL))
        )
        token = 0
        if profile.supervisor is not None:
            token = access.read_unsigned(profile.supervisor, TOKEN)
        loop.begin_sync()
        first = loop.run(steps.look_until_whole(loop), despite=(DriveFault, Stopped, DriveDiverged))
        check_positions(access, profile, first.counts, self._scales)
        self._learn_of_trips(first)
        return Started(identity=identity, rated_torques_nm=rated_torques_nm, token=token)

    def _listen(self, for_s: float) -> None:
        """Let nobody else be at work on this bus, as far as he is heard."""
        nodes = self._loop.nodes
        if nodes.wait_for_other_operator(for_s):
            raise ControlDenied(OPERATOR_NODE)
        self.go_on()
        if nodes.foreign_command:
            raise OtherMaster(
                f"Somebody else works on this bus: {nodes.foreign_command} came from another program. Nothing "
                "was told to the arm. End that program, or take its device off this bus, then connect again; "
                "`sarcal monitor` shows what it sends."
            )

    def undo(self, failure: BaseException) -> None:
        """Give the drives their own PDOs back, after what failed; what was set to 0 stays, and is told with it."""
        if self._configured:
            with suppress(BusError):
                self._command_nodes(NmtCommand.RESET_COMMUNICATION)
        if isinstance(failure, HardwareError):
            failure.stays = tuple(self._zeroed)

    def _check_drives(self, identity: ArmIdentity) -> tuple[ArmIdentity, tuple[float, ...]]:
        """Compare PDOs and the arm with profile and description; PDOs are written before, if the profile says so.

        The identity with what is known of the drives' watch, and rated torques in N m.
        """
        access, profile = self._access, self._profile
        if profile.configures_pdos:
            # First all that can be refused by reading: nothing is written into another arm, nor into one that
            # is not driven afterwards.
            found = self._check_arm(identity)
            check_communication(access, profile)
            self.go_on()
            self._configured = configure(access, profile, self._command_nodes)
            check_mapping(access, profile)
            self.go_on()
            return found
        check_mapping(access, profile)
        self.go_on()
        return self._check_arm(identity)

    def _check_arm(self, identity: ArmIdentity) -> tuple[ArmIdentity, tuple[float, ...]]:
        """Compare all but the PDOs, and take in how the nodes are watched."""
        access, profile, loop = self._access, self._profile, self._loop
        identifying.check_arm(access, identity, self._description, profile, period_s=self._period_s)
        loop.heartbeat_timeout_s = heartbeat_timeout_s(access, profile, loop.heartbeat_timeout_s)
        unwatching = check_operator_monitoring(access, profile)
        loop.watch.set_following_windows(following_windows_counts(access, profile, self._scales))
        rated_torques_nm = identifying.read_rated_torques_nm(access, profile)
        return replace(identity, unwatching=unwatching), rated_torques_nm

    def go_on(self) -> None:
        """Raise if STOP was pressed since this began, or nobody listens any more: nothing was, or will be, enabled."""
        failure = self._loop.failure
        if failure is not None:
            raise failure
        if self._pressed():
            raise Stopped(
                "STOP was pressed while connecting, and stays latched: nothing was enabled, and the connection "
                "is closed. Connect again first"
            )

    def _told(
        self, command: NmtCommand, obeyed: Callable[[float], tuple[int, ...]]
    ) -> tuple[int, ...]:
        """Give the nodes an NMT command and return those that do not obey; `obeyed` waits for them and says which.

        Nobody answers such a command: a node that is heard and does not obey is told once more, for either frame
        may have been lost.
        """
        self._command_nodes(command)
        missing = obeyed(self._boot_timeout_s)
        self.go_on()
        heard = [node for node in missing if node in self._loop.nodes.heard_at_s]
        if heard:
            self._command_nodes(command, heard)
            missing = obeyed(self._boot_timeout_s)
            self.go_on()
        return missing

    def _command_nodes(self, command: NmtCommand, nodes: Iterable[int] = ()) -> None:
        """Send an NMT command to these of the arm's nodes, or all: what else is on this bus is not ours to reset."""
        for node in nodes or self._profile.nodes:
            self._send(COB_NMT, bytes([command, node]))

    def _require_single(self) -> None:
        twice = self._access.duplicate_nodes()
        if twice:
            raise DuplicateNodeId(twice)

    def _learn_of_trips(self, first: Sample) -> None:
        """Ask drives that are in a fault why (603Fh): their emergencies were sent before we listened."""
        codes = {
            node: self._access.read_unsigned(node, ERROR_CODE)
            for node, status in zip(self._profile.drives, first.statuswords, strict=True)
            if state_of(status) in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
        }
        nodes = self._loop.nodes

        def note() -> Generator[Setpoints | None, Sample, None]:
            for node, code in codes.items():
                nodes.assume_fault(node, code, first.sync_count)
            yield from ()

        self._loop.run(note())


def _require(missing: tuple[int, ...]) -> None:
    if missing:
        raise NodeMissing(missing)

"""Starts the nodes of an arm and checks that they are the expected nodes.

Before a frame is sent, the start-up listens for another operator or master. By SDO it checks that no operator uses the
arm. Then it resets the communication of the arm's nodes only, waits for every boot-up, and compares the arm with the
arm's description. Last, it starts the heartbeat, the nodes (NMT) and SYNC.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from math import ceil
from typing import Final

from hardware import errors
from hardware.arm import ArmIdentity, DriveState
from hardware.canopen import drive_settings, identifying, objects
from hardware.canopen.cia402 import FAULT_STATES, POWERED_STATES, state_of
from hardware.canopen.configuring import configure, zero_residual_torques
from hardware.canopen.cyclic import Sample
from hardware.canopen.maps import check_communication, check_mapping, check_positions
from hardware.canopen.objects import NmtCommand, NmtState
from hardware.canopen.sdo import ObjectAccess
from hardware.control import motion_steps
from hardware.control.connection import Connection
from hardware.control.control_loop import Steps
from hardware.monitors.node_monitor import NMT_NAMES, nmt_state_name
from hardware.timing import Pace

MARGIN: Final = 1.5
"""Factor by which a drive's time-out (1016h) is extended, for reaction time and late answers."""
POLLS: Final = 10
"""Number of readings of the drives' states within `Timing.operator_timeout_s`."""

_Object = tuple[int, int]
"""Node and index."""


def _powered(values: Mapping[_Object, int]) -> dict[int, DriveState]:
    words = {node: word for (node, index), word in values.items() if index == objects.STATUSWORD}
    states = {node: state_of(word) for node, word in words.items()}
    return {node: state for node, state in states.items() if state in POWERED_STATES}


def _token_holder(values: Mapping[_Object, int]) -> int:
    return next((holder for (_, index), holder in values.items() if index == objects.TOKEN), 0)


def _read_all(access: ObjectAccess, needed: Sequence[_Object]) -> dict[_Object, int]:
    """Return the values of the objects that can be read. Reads are parallel, since an absent node costs a time-out."""

    def read(key: _Object) -> int | None:
        try:
            return int.from_bytes(access.read_once(*key), "little")
        except errors.HardwareError:
            return None

    with ThreadPoolExecutor(max(len(needed), 1)) as pool:
        answers = zip(needed, pool.map(read, needed), strict=True)
        return {key: value for key, value in answers if value is not None}


def _stated_timeout_s(access: ObjectAccess, nodes: Iterable[int]) -> float:
    """Return `MARGIN` times the longest operator time-out (1016h) among `nodes`, s; 0 if no node has one."""
    timeout_s = 0.0
    for node in nodes:
        with suppress(errors.BusError):
            timeout_s = max(
                timeout_s, MARGIN * (drive_settings.operator_timeout_s(access, node) or 0.0)
            )
    return timeout_s


class StartUp:
    """One start-up of the nodes of an arm over a connection that has just been opened."""

    def __init__(self, link: Connection) -> None:
        self._link, self._loop, self._access = link, link.loop, link.access
        self._profile, self._timing = link.profile, link.on_bus.timing
        self._configured: tuple[str, ...] = ()
        self._zeroed: list[str] = []
        self._pressed: Callable[[], bool] = lambda: False

    def run(self, press: object | None, *, takes_over: bool) -> ArmIdentity:
        """Find and check the nodes, start heartbeat and SYNC, and read rated torques, token and modes.

        `press`: latest press of STOP before the start-up; a later press cancels the start-up. `takes_over`: whether to
        take over drives that stay enabled although no operator is heard; if false, `ArmInUse` is raised for them.
        """
        try:
            return self._run(press, takes_over=takes_over)
        except BaseException as failure:
            # The drives' own PDOs are restored; objects set to 0 remain 0 and are listed in `failure`.
            if self._configured:
                with suppress(errors.BusError):
                    self._command_nodes(NmtCommand.RESET_COMMUNICATION)
            if isinstance(failure, errors.HardwareError):
                failure.kept_writes = tuple(self._zeroed)
            raise

    def _run(self, press: object | None, *, takes_over: bool) -> ArmIdentity:
        loop, access, profile = self._loop, self._access, self._profile
        self._pressed = lambda: loop.latch.last_press is not press
        loop.nodes.cancelled = lambda: self._pressed() or loop.failure is not None
        access.raise_if_cancelled = self._raise_if_cancelled
        loop.start()
        self._listen(self._timing.listen_s)
        # In fast forward no time passes for the drives, and no other program can use the simulated arm.
        if self._link.on_bus.pace is Pace.REAL_TIME:
            self._require_unused(takes_over=takes_over)
            self._listen(0.0)  # other programs' commands so far, before they are cleared
        loop.nodes.expect_boot_up()
        missing = self._send_nmt(
            NmtCommand.RESET_COMMUNICATION, lambda node: node in loop.nodes.booted
        )
        loop.nodes.boot_expected = False
        if missing and not profile.configures_pdos:
            # The present nodes may show a different set-up: report it together with the missing nodes.
            check_mapping(access, profile, missing)
        self._require(missing, NmtCommand.RESET_COMMUNICATION)
        identity = identifying.read_identity(access, profile, self._link.on_bus.description)
        access.require_single_answers()
        self._raise_if_cancelled()
        unwatching = self._check_drives(identity)
        access.require_single_answers()
        self._zeroed += zero_residual_torques(access, profile)
        zeroed = tuple(self._zeroed)
        self._raise_if_cancelled()
        loop.begin_heartbeat()
        waiting = self._send_nmt(NmtCommand.START, loop.nodes.is_operational)
        self._require(waiting, NmtCommand.START)
        if profile.supervisor is not None:
            self._link.token = access.read_unsigned(profile.supervisor, objects.TOKEN)
        loop.begin_sync()
        despite = errors.DriveFault, errors.Stopped, errors.DriveDiverged
        first = loop.run(motion_steps.first_complete_sample(loop), despite=despite)
        check_positions(access, profile, first.counts, self._link.scales)
        self._read_fault_codes(first)
        self._link.read_modes()
        self._raise_if_cancelled()
        self._pressed = lambda: False  # a later STOP ends no access, but a failed bus does
        configured = (*self._configured, *zeroed)
        return replace(identity, unwatching=unwatching, configured=configured, zeroed=zeroed)

    def _require_unused(self, *, takes_over: bool) -> None:
        """Raise an error if another operator may be using the arm.

        An operator that moves the arm may be silent for up to the drives' time-out (1016h). So if a drive has power or
        a node holds the token, this program listens for that time, at least for `Timing.operator_timeout_s`. By then
        the operator has been heard or the drives have stopped: a communication reset cannot hit a moving arm.

        Raises `ControlDenied` if the holder of the token is heard. After that time, unless `takes_over`, raises
        `ArmInUse` if a drive is still enabled, or if a drive is stopped and a node still holds the token. A stopped
        drive is accepted if the token is free: no operator uses that drive, and connecting enables nothing.
        """
        access, profile, timeout_s = self._access, self._profile, self._timing.operator_timeout_s
        statuswords = [(node, objects.STATUSWORD) for node in profile.drives]
        tokens = [] if profile.supervisor is None else [(profile.supervisor, objects.TOKEN)]
        values = _read_all(access, (*statuswords, *tokens))
        if values:  # again where a frame may have been lost
            again = [key for key in (*statuswords, *tokens) if key not in values]
            values |= _read_all(access, again)
        enabled, holder = _powered(values), _token_holder(values)
        if not enabled and not holder:
            return
        poll_s = timeout_s / POLLS
        stated = [*enabled, *(node for node, _ in tokens if holder)]
        timeout_s = max(timeout_s, _stated_timeout_s(access, stated))
        for _ in range(ceil(timeout_s / poll_s)):
            self._listen(poll_s)
            if holder in self._loop.nodes.foreign_nodes:
                raise errors.ControlDenied(holder)
            # A node without an answer keeps its last value.
            enabled_words = [key for key in statuswords if key[0] in enabled]
            values |= _read_all(access, [*enabled_words, *tokens])
            enabled, holder = _powered(values), _token_holder(values)
            if not enabled and not holder:
                return
        obeys = DriveState.OPERATION_ENABLED in enabled.values()
        if not takes_over and (obeys or (enabled and holder)):
            named = [
                f"{profile.who(n)} is in state '{state.value}'" for n, state in enabled.items()
            ]
            raise errors.ArmInUse(named, timeout_s)
        self._link.found_powered = {profile.joint_of[n]: state for n, state in enabled.items()}

    def _listen(self, for_s: float) -> None:
        """Listen for `for_s` s; raise an error if another operator or master is heard."""
        nodes = self._loop.nodes
        if nodes.wait_for(lambda: nodes.other_operator_at_s is not None, for_s):
            raise errors.ControlDenied(objects.OPERATOR_NODE)
        self._raise_if_cancelled()
        if nodes.foreign_command:
            raise errors.OtherMaster(
                f"Another program uses this bus: it sent {nodes.foreign_command}. Nothing "
                "was sent to the arm. End that program, or take its device off this bus, then connect again; "
                "`sarcal monitor` shows what it sends."
            )

    def _check_drives(self, identity: ArmIdentity) -> tuple[int, ...]:
        """Compare the PDOs with the profile and the arm with its description; write PDOs if the profile requires it.

        Returns the joints whose drives do not monitor the operator's heartbeat, or take no action when it is lost.
        """
        access, profile = self._access, self._profile
        if profile.configures_pdos:
            # All checks that only read come first: nothing is written into a wrong or refused arm.
            unwatching = self._check_arm(identity)
            check_communication(access, profile)
            self._raise_if_cancelled()
            self._configured = configure(access, profile, self._command_nodes)
        try:
            check_mapping(access, profile)
        except errors.MappingMismatch as unchanged:
            if not self._configured:
                raise
            refusals = [f"{text} although it was written" for text in unchanged.differences]
            raise errors.PdoSetupFailed(refusals) from unchanged
        self._raise_if_cancelled()
        return unwatching if profile.configures_pdos else self._check_arm(identity)

    def _check_arm(self, identity: ArmIdentity) -> tuple[int, ...]:
        """Check all but the PDOs, and set time-outs, windows and rated torques; return `ArmIdentity.unwatching`."""
        access, profile, loop, link = self._access, self._profile, self._loop, self._link
        identifying.check_arm(access, identity, link.on_bus.description, profile)
        loop.nodes.heartbeat_timeout_s = drive_settings.heartbeat_timeout_s(
            access, profile, loop.nodes.heartbeat_timeout_s
        )
        unwatching = drive_settings.check_operator_monitoring(access, profile)
        windows_counts = drive_settings.following_windows_counts(access, profile, link.scales)
        loop.watch.set_following_windows(windows_counts, link.scales)
        link.rated_torques_nm = identifying.read_rated_torques_nm(access, profile)
        return unwatching

    def _raise_if_cancelled(self) -> None:
        if (failure := self._loop.failure) is not None:
            raise failure
        if self._pressed():
            raise errors.Stopped(
                "STOP was pressed while connecting, and stays latched: nothing was enabled, and the connection "
                "is closed. Connect again first"
            )

    def _send_nmt(self, command: NmtCommand, complied: Callable[[int], bool]) -> tuple[int, ...]:
        """Send an NMT command; return the nodes that have not `complied` after a second attempt.

        NMT commands are not acknowledged, and a command or a heartbeat may be lost. So the command is sent again to
        nodes that are heard but have not complied.
        """
        nodes, timeout_s = self._loop.nodes, self._timing.boot_timeout_s
        self._command_nodes(command)
        missing = nodes.wait_for_nodes(complied, timeout_s)
        self._raise_if_cancelled()
        if heard := [node for node in missing if node in nodes.heard_at_s]:
            self._command_nodes(command, heard)
            missing = nodes.wait_for_nodes(complied, timeout_s)
            self._raise_if_cancelled()
        return missing

    def _require(self, missing: tuple[int, ...], command: NmtCommand) -> None:
        nodes = self._loop.nodes
        answering = _read_all(self._access, [(node, objects.DEVICE_TYPE) for node in missing])
        self._raise_if_cancelled()
        not_started = dict[int, str]()
        for node in missing:
            state = nodes.nmt_state.get(node, NmtState.BOOT_UP)
            if state != NmtState.BOOT_UP and node not in nodes.silent():
                name, stays = NMT_NAMES[command], nmt_state_name(state)
                not_started[node] = f"stays {stays} after the NMT command {name!r}"
            elif (node, objects.DEVICE_TYPE) in answering:
                not_started[node] = "answers by SDO, but sends no heartbeat"
        if silent := tuple(node for node in missing if node not in not_started):
            raise errors.NodeMissing(silent)
        if not_started:
            raise errors.NodeNotStarted(not_started)

    def _command_nodes(self, command: NmtCommand, nodes: Iterable[int] = ()) -> None:
        """Send an NMT command to each of `nodes`, by default to all nodes of the arm; never to other devices."""
        for node in nodes or self._profile.nodes:
            self._link.wire.send(objects.COB_NMT, bytes([command, node]))

    def _read_fault_codes(self, first: Sample) -> None:
        """Record the error code (603Fh) of each drive that `first` shows in fault, as its emergency was missed."""
        faulty = first.joints_in(FAULT_STATES)
        nodes_in_fault = [self._profile.drives[joint - 1] for joint in faulty]
        codes = {n: self._access.read_unsigned(n, objects.ERROR_CODE) for n in nodes_in_fault}
        nodes = self._loop.nodes

        def note() -> Steps[None]:
            for node, code in codes.items():
                nodes.assume_fault(node, code, first.sync_count)
            yield from ()

        self._loop.run(note())

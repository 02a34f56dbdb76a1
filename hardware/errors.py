"""Errors of the arm and the bus, with details as attributes."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum


class HardwareError(Exception):
    """Base class of all errors of the arm, its bus and its instrument.

    `kept_writes`: sentences that describe values which were written into drives before the error and remain there.
    `drives_after`: sentence that says whether the drives were then switched off; empty if that was not tried.
    """

    kept_writes: tuple[str, ...] = ()
    drives_after: str = ""

    def __str__(self) -> str:
        text = super().__str__()
        if self.drives_after:
            text = f"{text.removesuffix('.')}. {self.drives_after}"
        if not self.kept_writes:
            return text
        writes = "; ".join(self.kept_writes)
        return f"{text.removesuffix('.')}. Written before, and not undone: {writes}."


class BusError(HardwareError):
    """The bus cannot be opened or has gone silent."""


class BusSettingsError(BusError):
    """The settings of a bus are wrong; nothing was opened."""


class FramesLost(BusError):
    """Nodes do not answer in time. `requests` gives, for each node, the number of unanswered and of all requests."""

    def __init__(self, requests: Mapping[int, tuple[int, int]]) -> None:
        self.requests = dict(requests)
        counted = ", ".join(
            f"{lost} of {sent} requests to node {node}" for node, (lost, sent) in requests.items()
        )
        super().__init__(
            f"The bus loses or delays frames: {counted} were not answered in time. Check cables, connectors, "
            "terminators, bitrate and any gateway."
        )


class EndlessAnswer(BusError):
    """A node does not end its answer to an SDO read."""

    def __init__(
        self, node: int, index: int, subindex: int, received: int, max_bytes: int, max_s: float
    ) -> None:
        self.received = received
        super().__init__(
            f"Node {node} does not end its answer when asked for {index:04X}h sub {subindex}: it has sent {received} "
            f"bytes (limits: {max_bytes} bytes, {max_s:.1f} s). Its SDO server has failed: switch the node off and on"
        )


class HostLatencyExceeded(BusError):
    """Since control was taken, this computer had `times` host latencies; `last_s` is the length of the last one."""

    def __init__(self, times: int, last_s: float) -> None:
        self.last_s = last_s
        often = "once" if times == 1 else f"{times} times"
        super().__init__(
            f"this computer was too busy: since control was taken it was late {often}, the last time by "
            f"{last_s:.1f} s. Each attempt to upload the parameters missed answers, or lost control of the arm"
        )


class NodeMissing(HardwareError):
    """Nodes of the arm do not answer."""

    def __init__(self, nodes: tuple[int, ...]) -> None:
        self.nodes = nodes
        super().__init__(
            f"no answer from node{'s' if len(nodes) > 1 else ''} {', '.join(map(str, nodes))}. "
            "Check power, cable and bitrate (a virtual arm must be running: `sarcal controller -i loopback`)"
        )


class NodeNotStarted(HardwareError):
    """Nodes of the arm are on the bus but do not start; `nodes` maps each node to its behaviour, as text."""

    def __init__(self, nodes: Mapping[int, str]) -> None:
        self.nodes = dict(nodes)
        what = "; ".join(f"node {node} {text}" for node, text in nodes.items())
        super().__init__(
            f"{what}. Nothing was enabled. Check faults, NMT state and heartbeat period (1017h) with the tool of the "
            "node's maker"
        )


class WrongArm(HardwareError):
    """The arm on the bus is not the one the arm file describes."""


class ProfileRemedy(Enum):
    """How a bus profile can help with an object that differs, if at all; the value is the end of a remedy text."""

    NONE = " (a bus profile cannot change this)"
    HEARTBEAT_PERIOD = ", or allow that period in a bus profile (heartbeat: slowest_ms)"
    SEND_ZERO = (
        ", or have a bus profile send it as 0 with the commands, or write 0 (pdo_maps: configured)"
    )
    WRITE_PDO = (
        ", or have a bus profile write the expected values at every connection (`sarcal probe --draft FILE "
        "--configure` writes one)"
    )
    DESCRIBE_PDO = ", or describe them in a bus profile (`sarcal probe --draft FILE` writes one)"


@dataclass(frozen=True, slots=True)
class ObjectMismatch:
    """An object of a node, or one sub-index of the object, that differs from what is required."""

    node: int
    index: int
    sub: int | None
    expected: str
    found: str
    remedy: ProfileRemedy = ProfileRemedy.DESCRIBE_PDO

    @property
    def object(self) -> str:
        """Index as written in messages, e.g. ``1A00h``."""
        return f"{self.index:04X}h"

    def __str__(self) -> str:
        place = self.object if self.sub is None else f"{self.object} sub {self.sub}"
        return f"node {self.node}, {place}: expected {self.expected}, found {self.found}"


class MappingMismatch(HardwareError):
    """Nodes differ from the profile; `differences` has a text per difference and per silent node."""

    def __init__(self, differences: Sequence[ObjectMismatch], silent: Sequence[str] = ()) -> None:
        self.differences = (*map(str, differences), *silent)
        super().__init__(
            "These nodes are not set up as this program requires: "
            f"{'; '.join(self.differences)}. Nothing was enabled. {'. '.join(_remedies(differences))}, then connect "
            "again."
        )


class MappingChanged(HardwareError):
    """The set-up of nodes was changed during the connection."""

    def __init__(self, differs: MappingMismatch) -> None:
        super().__init__(
            "While connected, the set-up of these nodes was changed, and their answers to SYNC no longer carry the "
            f"joint's position: {'; '.join(differs.differences)}. Find the program or maker's tool that did it, "
            "restore the set-up, then connect again"
        )


def _remedies(differences: Sequence[ObjectMismatch]) -> Iterator[str]:
    others = [each for each in differences if each.remedy is not ProfileRemedy.DESCRIBE_PDO]
    for kind in ProfileRemedy:
        if objects := sorted({each.object for each in others if each.remedy is kind}):
            expected = "in these drives as expected, with their maker's tool"
            yield f"Set {', '.join(objects)} {expected}{kind.value}"
    if len(others) < len(differences):
        which = "the other objects of these drives" if others else "these drives"
        yield f"Set up {which} as expected, with their maker's tool{ProfileRemedy.DESCRIBE_PDO.value}"


class PdoSetupFailed(HardwareError):
    """Drives lack or refuse the PDOs of the bus profile; `refusals` name node and object."""

    _FAILED = "Setting up the drives' PDOs as in the bus profile (pdo_maps: configured) failed"
    _REMEDY = (
        "The drive's maps may be fixed: describe them in a profile with pdo_maps: compared (`sarcal probe --draft "
        "FILE` writes one), or set the drive up with its maker's tool, then connect again."
    )

    def __init__(self, refusals: Sequence[str]) -> None:
        self.refusals = tuple(refusals)
        super().__init__(
            f"{self._FAILED}: {'; '.join(self.refusals)}. Nothing was enabled; PDOs that were written are undone. "
            f"{self._REMEDY}"
        )


class ZeroingFailed(PdoSetupFailed):
    """Drives refuse to set a torque or an offset to 0; `refusals` name node and object."""

    _FAILED = "Setting to 0 the torques or offsets that drives add to commands (pdo_maps: configured) failed"
    _REMEDY = (
        "Set them to 0 with the maker's tool, or map these objects in an RPDO of the profile, which sends 0; then "
        "connect again."
    )


class SdoRefused(HardwareError):
    """A drive or the supervisor refused an object access."""

    def __init__(self, node: int, index: int, subindex: int, code: int, text: str) -> None:
        self.node, self.index, self.subindex, self.code = node, index, subindex, code
        super().__init__(f"node {node} refused {index:04X}h sub {subindex}: {text} ({code:08X}h)")


class ControlDenied(HardwareError):
    """Node `holder` is in control. If `holder` is 0, the supervisor refused control and gave `reason`."""

    def __init__(self, holder: int, reason: str = "") -> None:
        self.holder = holder
        text = f"control of this arm was refused: {reason or 'the supervisor gives no reason'}"
        if holder:
            text = f"node {holder} is in control of this arm"
            if holder == 127:  # the number of every operator, this program included
                text = (
                    "another program on this bus sends the heartbeat of an operator (node 127), and may be in control "
                    "of this arm"
                )
            text += "; `sarcal monitor` shows what that program sends"
        super().__init__(text)


class ModeNotReached(HardwareError):
    """A drive does not report the requested mode, or (`not_following`) reports the mode without bit 12 (follows)."""

    def __init__(
        self, joint: int, wanted: str, actual: str, *, not_following: bool = False
    ) -> None:
        self.joint, self.wanted, self.actual = joint, wanted, actual
        remedy = (
            "have the drive set that bit, with the tool of its maker: without this bit a joint that does not follow "
            "its target is not detected"
            if not_following
            else "`sarcal arm-check --through look` lists the drive's modes"
        )
        super().__init__(
            f"joint {joint} was asked for {wanted} mode and reports {actual}; {remedy}"
        )


class DriveFault(HardwareError):
    """A drive has tripped, or only reported an error if `tripped` is false. `code`: CiA 402 code of the emergency."""

    def __init__(self, joint: int, code: int, text: str, *, tripped: bool = True) -> None:
        self.joint, self.code = joint, code
        super().__init__(
            f"joint {joint} tripped: {text} ({code:04X}h)"
            if tripped
            else f"joint {joint} reports an error: {text} ({code:04X}h)"
        )


class DriveDropout(DriveFault):
    """A drive left *operation enabled*, or stopped following its target, without a command or an emergency.

    `conditions`: what the drive's statusword states about the cause (`hardware.canopen.cia402.conditions`).
    """

    def __init__(
        self, joint: int, state: str, *, not_following: bool = False, conditions: str = ""
    ) -> None:
        self.joint, self.code, self.state, self.not_following = joint, 0, state, not_following
        text = (
            f"joint {joint}: its drive is enabled, but no longer follows its target{conditions}"
            if not_following
            else f"joint {joint}: the drive is in state '{state}'{conditions}; it was enabled, and this program did "
            "not disable it. It is not enabled again automatically"
        )
        HardwareError.__init__(self, text)


class NodeRestarted(BusError):
    """A node has restarted: its position counter may have been reset."""

    def __init__(self, nodes: tuple[int, ...], names: Sequence[str]) -> None:
        self.nodes = nodes
        named, one = " and ".join(names), len(names) == 1
        has, counters = ("has", "its counter") if one else ("have", "their counters")
        super().__init__(
            f"{named} {has} restarted, as after a loss of power: {counters} may have been reset. Nothing "
            "has been captured since. Connect again: the arm is first compared with the captured poses"
        )


class SensorFault(HardwareError):
    """A joint's reading jumped, or does not change (`stuck`). `since_sync`: SYNC of the first wrong reading or None."""

    def __init__(
        self, joint: int, text: str, since_sync: int | None = None, *, stuck: bool = False
    ) -> None:
        self.joint, self.since_sync, self.stuck = joint, since_sync, stuck
        super().__init__(f"joint {joint} {text}")


class DriveDiverged(SensorFault):
    """Uncommanded motion: a joint left its target, or moved after a stop (`stopped`). The drive reports no fault."""

    def __init__(
        self,
        joint: int,
        counts: int,
        since_sync: int,
        *,
        stopped: bool = False,
        angle_rad: float | None = None,
    ) -> None:
        self.counts, self.stopped = counts, stopped
        angle = "" if angle_rad is None else f" ({math.degrees(angle_rad):+.1f} deg)"
        text = (
            f"has moved by {counts:+d} counts{angle} after it was stopped, and its drive reports no fault: that drive "
            "was commanded to switch off"
            if stopped
            else f"is {counts:+d} counts from its target{angle}, and its drive reports no fault: the arm has been "
            "stopped, and that drive commanded to switch off"
        )
        super().__init__(joint, text, since_sync)


class DuplicateNodeId(HardwareError):
    """Nodes send surplus answers: two devices share a node number, or another program sends requests to these nodes.

    `asked_by_others`: whether requests of another program to each of these nodes were heard.
    """

    def __init__(self, nodes: tuple[int, ...], *, asked_by_others: bool = False) -> None:
        self.nodes = nodes
        named = " and ".join(map(str, nodes))
        super().__init__(
            f"another program sends SDO requests to node {named}, and this program cannot distinguish the answers from "
            "those to its own requests. End that program, then connect again"
            if asked_by_others
            else f"two devices answer as node {named}. Take one off the bus, or give it another number, then "
            "connect again"
        )


class OtherMaster(HardwareError):
    """Another program on the bus commands this arm."""


class ArmInUse(OtherMaster):
    """Another program has enabled the arm's drives, but no operator's heartbeat was heard during `listened_s`."""

    def __init__(self, enabled: Sequence[str], listened_s: float) -> None:
        self.listened_s = listened_s
        super().__init__(
            f"This arm is enabled, and not by this program: {', '.join(enabled)}. No operator was heard for "
            f"{listened_s:.1f} s, but the drives stay enabled. Nothing was reset. End the program that enabled "
            "them (`sarcal monitor` shows what is sent), or, keeping clear, switch them off with `sarcal reset`"
        )


class Stopped(HardwareError):
    """STOP is latched: nothing moves until it is reset."""


class StopLatched(Stopped):
    """STOP is latched, and this program has already reported why: STOP was pressed, or the arm was silent."""


class CommandRefused(HardwareError):
    """A command is outside the limits, or not permitted in the present state of the arm; it was not sent."""


class DriveNotReady(CommandRefused):
    """A command is not permitted in the present `state` of a drive. Other drives may have been commanded.

    `failed`: what could not be done. `conditions`: what the drive's statusword states about the cause.
    """

    def __init__(self, joint: int, state: str, *, failed: str = "", conditions: str = "") -> None:
        self.joint, self.state = joint, state
        super().__init__(f"joint {joint}{failed}: the drive is in state '{state}'{conditions}")


class TargetRefused(CommandRefused):
    """A drive refused a target that was sent to it, and keeps its previous one."""


class UploadRefused(HardwareError):
    """The supervisor refused a parameter document; the previous document stays active."""


class UploadUnknown(HardwareError):
    """The commit of a parameter document was sent, but whether it was carried out is unknown."""


class InstrumentError(HardwareError):
    """The instrument that measures the endpoint is silent, disconnected, or sends unusable data."""

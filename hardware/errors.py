"""Errors of the arm and the bus, with the facts to act on. Knows no screen; the session words them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum


class HardwareError(Exception):
    """Base of everything that can go wrong between the operator and the arm.

    `stays` is what was written into drives before, and is not undone: a sentence each.
    """

    stays: tuple[str, ...] = ()

    def __str__(self) -> str:
        text = super().__str__()
        if not self.stays:
            return text
        return f"{text.removesuffix('.')}. Written before, and not undone: {'; '.join(self.stays)}."


class BusError(HardwareError):
    """The bus cannot be opened or has gone silent."""


class BusSettingsError(BusError):
    """No such bus can be meant: what names it is wrong, and nothing was opened."""


class FramesLost(BusError):
    """Nodes that are there do not answer in time: `requests` says of each how often, and of how many requests."""

    def __init__(self, requests: Mapping[int, tuple[int, int]]) -> None:
        self.requests = dict(requests)
        counted = ", ".join(
            f"{left} of {asked} to node {node}" for node, (left, asked) in self.requests.items()
        )
        super().__init__(
            f"The bus loses frames, or keeps them back: of the requests {counted} were not answered in time. Check "
            "cables, connectors, terminators, bitrate and any gateway."
        )


class HostLatencyExceeded(BusError):
    """The operator's computer was too busy to listen: `times` so often in control, by `longest_s` at most."""

    def __init__(self, times: int, longest_s: float) -> None:
        self.times, self.longest_s = times, longest_s
        often = "once" if times == 1 else f"{times} times"
        super().__init__(
            f"this computer was too busy to listen to the arm: late {often} since it took control, by {longest_s:.1f} "
            "s at most. Answers were missed, or control lapsed, each time that it was tried"
        )


class NodeMissing(HardwareError):
    """Nodes that should answer do not."""

    def __init__(self, nodes: tuple[int, ...]) -> None:
        self.nodes = nodes
        super().__init__(
            f"no answer from node{'s' if len(nodes) > 1 else ''} {', '.join(map(str, nodes))}. "
            "Check power, cable and bitrate; a virtual arm for another process is started with: "
            "sarcal controller -i loopback"
        )


class WrongArm(HardwareError):
    """The arm on the bus is not the one the arm file describes."""


class ProfileRemedy(Enum):
    """How a bus profile can say that a drive has an object otherwise."""

    DESCRIBE_PDO = "describe it"
    HEARTBEAT_PERIOD = "heartbeat: slowest_ms"
    SEND_ZERO = "send 0 in a PDO, or write it"
    NONE = "this program needs it as it expects it"


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectMismatch:
    """An object of a node (all of it, or a sub-index) that is not as it has to be."""

    node: int
    index: int
    sub: int | None = None
    expected: str
    found: str
    remedy: ProfileRemedy = ProfileRemedy.DESCRIBE_PDO

    @property
    def object(self) -> str:
        """As messages name it."""
        return f"{self.index:04X}h"

    def __str__(self) -> str:
        place = self.object if self.sub is None else f"{self.object} sub {self.sub}"
        return f"node {self.node}, {place}: expected {self.expected}, found {self.found}"


class MappingMismatch(HardwareError):
    """Nodes that are set up otherwise: `differences` say node, object, expected and found, or who does not answer."""

    def __init__(self, found: Sequence[ObjectMismatch], silent: Sequence[str] = ()) -> None:
        self.found = tuple(found)
        self.differences = (*map(str, found), *silent)
        super().__init__(
            "These nodes are not set up as this program drives them: "
            f"{'; '.join(self.differences)}. Nothing was enabled. {'. '.join(_remedies(self.found))}, then connect "
            "again."
        )


class MappingChanged(HardwareError):
    """Nodes that were set up otherwise while they were connected; `differs` is what is found of them now."""

    def __init__(self, differs: MappingMismatch) -> None:
        self.differs = differs
        super().__init__(
            "Since they were connected, these nodes were set up otherwise, and what they say to a SYNC is no longer "
            f"where their joint is: {'; '.join(differs.differences)}. Find who did that, a maker's tool or another "
            "program, and set them up as before, then connect again"
        )


def _remedies(found: Sequence[ObjectMismatch]) -> Iterator[str]:
    """What to do about these, by how a bus profile can say it."""
    for kind, otherwise in (
        (ProfileRemedy.NONE, ": no bus profile can say that"),
        (
            ProfileRemedy.HEARTBEAT_PERIOD,
            ", or say in a bus profile how slow it is (heartbeat: slowest_ms)",
        ),
        (
            ProfileRemedy.SEND_ZERO,
            ", or have a bus profile send it as 0 with the commands, or write 0 (pdo_maps: configured)",
        ),
    ):
        objects = sorted({each.object for each in found if each.remedy is kind})
        if objects:
            yield (
                f"Set {', '.join(objects)} in these drives as expected, with their maker's tool{otherwise}"
            )
    described = [each for each in found if each.remedy is ProfileRemedy.DESCRIBE_PDO]
    if described:
        yield (
            f"{'The rest: commission' if len(described) < len(found) else 'Commission'} them as expected, or "
            "describe them in a bus profile (`sarcal probe --draft FILE` writes one)"
        )


class PdoSetupFailed(HardwareError):
    """Drives that lack or refuse the PDOs which the bus profile has written: `refusals` name node and object."""

    _FAILED = "The bus profile has the drives' PDOs set up (pdo_maps: configured), and that failed"
    _REMEDY = (
        "Such maps may be fixed: describe what the drive has (`sarcal probe --draft FILE` writes it down) with "
        "pdo_maps: compared, or set the drive up with its maker's tool, then connect again."
    )

    def __init__(self, refusals: Sequence[str]) -> None:
        self.refusals = tuple(refusals)
        super().__init__(
            f"{self._FAILED}: {'; '.join(self.refusals)}. Nothing was enabled; PDOs that were written are undone. "
            f"{self._REMEDY}"
        )


class ZeroingFailed(PdoSetupFailed):
    """Drives that keep a torque or an offset, which the bus profile has set to 0: `refusals` name node and object."""

    _FAILED = (
        "The bus profile has what these drives would add to a command set to 0 (pdo_maps: configured), and that "
        "failed"
    )
    _REMEDY = (
        "Set it to 0 with the drive's maker's tool, or have a PDO of the profile's commands carry that object, "
        "which then is sent as 0; then connect again."
    )


class SdoRefused(HardwareError):
    """A drive or the supervisor refused an object access."""

    def __init__(self, node: int, index: int, subindex: int, code: int, text: str) -> None:
        self.node, self.index, self.subindex, self.code = node, index, subindex, code
        super().__init__(f"node {node} refused {index:04X}h sub {subindex}: {text} ({code:08X}h)")


class ControlDenied(HardwareError):
    """Control of the arm is not ours: somebody else has it, or (holder 0) it was not given.

    `why` are the supervisor's words, where there are any.
    """

    def __init__(self, holder: int, why: str = "") -> None:
        self.holder = holder
        if holder:
            super().__init__(
                f"node {holder} is in control of this arm; `sarcal monitor` shows what that program sends"
            )
        else:
            because = why or "the supervisor does not say why"
            super().__init__(f"control of this arm was not given: {because}")


class ModeNotReached(HardwareError):
    """A drive did not report the mode it was asked for, or (`not_following`) not that it follows its target in it."""

    def __init__(
        self, joint: int, wanted: str, actual: str, *, not_following: bool = False
    ) -> None:
        self.joint, self.wanted, self.actual = joint, wanted, actual
        remedy = (
            "have the drive set that bit, with its maker's tool: without it nobody sees whether the joint goes where "
            "it is told"
            if not_following
            else "`sarcal arm-check --through look` shows which modes its drive has"
        )
        super().__init__(
            f"joint {joint} was asked for {wanted} mode and reports {actual}; {remedy}"
        )


class DriveFault(HardwareError):
    """A drive tripped. `code` is the CiA 402 error code of its emergency message."""

    def __init__(self, joint: int, code: int, text: str) -> None:
        self.joint, self.code = joint, code
        super().__init__(f"joint {joint} tripped: {text} ({code:04X}h)")


class DriveDropout(DriveFault):
    """A drive that was enabled is not any more, nor by a command from here, and no emergency says why.

    `state` are the words of its state. One that is `not_following` is enabled still, and does not follow its target.
    """

    def __init__(self, joint: int, state: str, *, not_following: bool = False) -> None:
        self.joint, self.code, self.state, self.not_following = joint, 0, state, not_following
        told = (
            f"joint {joint}: its drive is enabled and says no more that it follows its target (6041h, bit 12)"
            if not_following
            else f"joint {joint}: the drive is in {state}; it was enabled, and was not told to be otherwise from "
            "here. It is not switched on again by itself"
        )
        HardwareError.__init__(self, told)


class NodeRestarted(BusError):
    """A node has booted by itself: what it counted since may have begun anew."""

    def __init__(self, nodes: tuple[int, ...], names: Sequence[str]) -> None:
        self.nodes = nodes
        named = " and ".join(names)
        super().__init__(
            f"{named} has restarted, as after a loss of power: its counter may have begun anew. Nothing "
            "was captured since. Connect again: the arm is compared with its poses first"
        )


class SensorFault(HardwareError):
    """A joint's reading cannot be true: it jumped, or it stands still while the joint moves.

    `since_sync` is since when, where that is known; of one that is `stuck` only that it has read alike since.
    """

    def __init__(
        self, joint: int, text: str, since_sync: int | None = None, *, stuck: bool = False
    ) -> None:
        self.joint, self.since_sync, self.stuck = joint, since_sync, stuck
        super().__init__(f"joint {joint} {text}")


class DriveDiverged(SensorFault):
    """A joint is not where it was told to be, and its drive does not say so: the arm has been stopped.

    One that was `stopped` before, by whomever, has gone on.
    """

    def __init__(self, joint: int, counts: int, since_sync: int, *, stopped: bool = False) -> None:
        self.counts, self.stopped = counts, stopped
        told = (
            f"has moved by {counts:+d} counts after it was stopped, and its drive does not say so: that drive "
            "has been switched off"
            if stopped
            else f"is {counts:+d} counts from where it was told to be, and its drive does not say so: the arm has "
            "been stopped, and that drive switched off"
        )
        super().__init__(joint, told, since_sync)


class DuplicateNodeId(HardwareError):
    """More than one device answers to a node number."""

    def __init__(self, nodes: tuple[int, ...]) -> None:
        self.nodes = nodes
        named = " and ".join(map(str, nodes))
        super().__init__(
            f"two devices answer as node {named}. Take one off the bus, or give it another number, then "
            "connect again"
        )


class OtherMaster(HardwareError):
    """Somebody else on the bus commands this arm."""


class ArmInUse(OtherMaster):
    """The arm's drives are enabled, and not by this program; nobody was heard for `listened_s`."""

    def __init__(self, enabled: Sequence[str], listened_s: float) -> None:
        self.enabled, self.listened_s = tuple(enabled), listened_s
        super().__init__(
            f"This arm is enabled, and not by this program: {', '.join(enabled)}. Nobody was heard for "
            f"{listened_s:.1f} s, but the drives have not let go. Nothing was reset. End the program that enabled "
            "them (`sarcal monitor` shows what is sent), or, keeping clear, have `sarcal reset` switch them off"
        )


class Stopped(HardwareError):
    """STOP is latched: nothing moves until it is reset."""


class StopLatched(Stopped):
    """STOP is latched by this program itself, which has said why: it was pressed, or nothing was heard."""


class CommandRefused(HardwareError):
    """The limits module would not let a command out."""


class UploadRefused(HardwareError):
    """The supervisor refused a parameter document; its previous one stays active."""


class UploadUnknown(HardwareError):
    """The supervisor was told to make a parameter document the active one, and nobody knows whether it has."""


class InstrumentError(HardwareError):
    """The instrument that measures the endpoint is silent, gone, or says what cannot be used."""

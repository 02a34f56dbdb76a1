"""Errors of the arm and the bus, with the facts to act on. Knows no screen; the session words them."""

from __future__ import annotations

from collections.abc import Sequence


class HardwareError(Exception):
    """Base of everything that can go wrong between the operator and the arm."""


class BusError(HardwareError):
    """The bus cannot be opened or has gone silent."""


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


class MappingDiffers(HardwareError):
    """Nodes that are set up otherwise: `differences` name node, object, expected and found."""

    def __init__(self, differences: Sequence[str]) -> None:
        self.differences = tuple(differences)
        super().__init__(
            "These nodes are not set up as this program drives them: "
            f"{'; '.join(self.differences)}. Nothing was enabled. Commission them as expected, or describe "
            "them in a bus profile (`sarcal probe --draft FILE` writes one), then connect again."
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
            super().__init__(f"node {holder} is in control of this arm")
        else:
            because = why or "the supervisor does not say why"
            super().__init__(f"control of this arm was not given: {because}")


class ModeNotReached(HardwareError):
    """A drive did not report the mode it was asked for."""

    def __init__(self, joint: int, wanted: str, actual: str) -> None:
        self.joint, self.wanted, self.actual = joint, wanted, actual
        super().__init__(f"joint {joint} was asked for {wanted} mode and reports {actual}")


class DriveFault(HardwareError):
    """A drive tripped. `code` is the CiA 402 error code of its emergency message."""

    def __init__(self, joint: int, code: int, text: str) -> None:
        self.joint, self.code = joint, code
        super().__init__(f"joint {joint} tripped: {text} ({code:04X}h)")


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


class TwoDevices(HardwareError):
    """More than one device answers to a node number."""

    def __init__(self, nodes: tuple[int, ...]) -> None:
        self.nodes = nodes
        named = " and ".join(map(str, nodes))
        super().__init__(
            f"two devices answer as node {named}. Take one off the bus, or give it another number, then "
            "connect again"
        )


class Intruder(HardwareError):
    """Somebody else on the bus commands this arm."""


class Stopped(HardwareError):
    """STOP is latched: nothing moves until it is reset."""


class CommandRefused(HardwareError):
    """The limits module would not let a command out."""


class UploadRefused(HardwareError):
    """The supervisor refused a parameter document; its previous one stays active."""


class InstrumentError(HardwareError):
    """The instrument that measures the endpoint is silent, gone, or says what cannot be used."""

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
    """Drives whose frames would be misread: `differences` name node, object, expected and found."""

    def __init__(self, differences: Sequence[str]) -> None:
        self.differences = tuple(differences)
        super().__init__(
            "The drives' frames do not carry what this program reads in them: "
            f"{'; '.join(self.differences)}. Nothing was enabled. Commission these drives with the PDOs "
            "that this arm is driven with, then connect again."
        )


class SdoRefused(HardwareError):
    """A drive or the supervisor refused an object access."""

    def __init__(self, node: int, index: int, subindex: int, code: int, text: str) -> None:
        self.node, self.index, self.subindex, self.code = node, index, subindex, code
        super().__init__(f"node {node} refused {index:04X}h sub {subindex}: {text} ({code:08X}h)")


class ControlDenied(HardwareError):
    """Somebody else holds the control token, or another operator's heartbeat is on the bus."""

    def __init__(self, holder: int) -> None:
        self.holder = holder
        super().__init__(f"node {holder} is in control of this arm")


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


class Stopped(HardwareError):
    """STOP is latched: nothing moves until it is reset."""


class CommandRefused(HardwareError):
    """The limits module would not let a command out."""


class UploadRefused(HardwareError):
    """The supervisor refused a parameter document; its previous one stays active."""

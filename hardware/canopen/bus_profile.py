"""How the nodes of an arm are set up on the bus: numbers, PDOs, modes. Facts alone: knows no bus and no file.

SYNC (080h), emergencies, SDO and heartbeats are where CiA 301's predefined connection set has them; what a
maker is free to choose is here, and is compared with every drive before anything is enabled, or written into it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from hardware.arm import JointMode
from hardware.canopen.objects import (
    CONTROLWORD,
    DEVICE_TYPE_MASK,
    DRIVE_DEVICE_TYPE,
    MODE,
    MODE_CODE,
    POSITION_ACTUAL,
    STATUSWORD,
    TARGET_POSITION,
    TORQUE_ACTUAL,
)

Entry = tuple[int, int, int]
"""Index, sub-index, bits."""

COMMANDED: Final = (CONTROLWORD, TARGET_POSITION, MODE)
"""What the RPDOs of a joint carry between them."""
ANSWERED: Final = (STATUSWORD, POSITION_ACTUAL, TORQUE_ACTUAL)
"""What its TPDOs bring with every SYNC."""
LEFT_AT_ZERO: Final = frozenset({0x6071, 0x60B0, 0x60B1, 0x60B2, 0x60FF, *range(0x0001, 0x0020)})
"""What an RPDO may carry beside: target torque and velocity, their offsets, and dummies; all sent as 0."""
FIELD_BITS: Final = (8, 16, 32, 64)
"""Widths of what is read or sent; whatever else is mapped may have any whole number of bytes."""
LONGEST_HEARTBEAT_MS: Final = 10_000
"""No profile may allow more."""
SLOWEST_HEARTBEAT_MS: Final = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Pdo:
    """One PDO of one joint: its number (1 is that of 1400h, 1600h, 1800h, 1A00h), identifier and map."""

    number: int
    cob_id: int
    entries: tuple[Entry, ...]

    @property
    def carried(self) -> frozenset[int]:
        """Indices of the objects in it."""
        return frozenset(index for index, _, _ in self.entries)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointProfile:
    """One joint on the bus.

    Attributes
    ----------
    node
        Its node number.
    commands, answers
        RPDOs and TPDOs that carry what is commanded and answered.
    direction
        -1 where the drive counts against the arm file's sense, else 1.
    counts_per_rev
        Position units of the drive in one turn of the joint; None: as the arm file's sensor has them.
    zero_counts
        6064h where the joint's sensor coordinate is 0.
    rated_torque_nm
        What 1000 per mille of 6077h mean; None: the drive says it (6076h).
    """

    node: int
    commands: tuple[Pdo, ...]
    answers: tuple[Pdo, ...]
    direction: int = 1
    counts_per_rev: float | None = None
    zero_counts: int = 0
    rated_torque_nm: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BusProfile:
    """An arm of joints 1..n on the bus.

    Attributes
    ----------
    name
        What the operator calls it.
    joints
        In order.
    supervisor
        Node that says which arm this is, who is in control, and keeps the parameters; None: no such node.
    serial_number
        Of an arm without a supervisor.
    device_type, device_type_mask
        1000h of a drive that can be driven, in the bits of the mask.
    mode_codes
        6060h of each joint mode.
    configures_pdos
        Whether PDOs that differ are written into the drives whenever they are connected to, or refused.
    compared
        Objects in which drives describe themselves, and which are compared with the arm file.
    slowest_heartbeat_ms
        A drive whose 1017h is longer is refused: its loss would go unnoticed.
    heartbeat_timeout_s, sdo_timeout_s
        Patience with a node; None: the program's own.
    """

    name: str
    joints: tuple[JointProfile, ...]
    supervisor: int | None
    serial_number: str = ""
    device_type: int = DRIVE_DEVICE_TYPE
    device_type_mask: int = DEVICE_TYPE_MASK
    mode_codes: Mapping[JointMode, int] = field(default_factory=lambda: MappingProxyType(MODE_CODE))
    configures_pdos: bool = False
    compared: frozenset[int] = frozenset()
    slowest_heartbeat_ms: int = SLOWEST_HEARTBEAT_MS
    heartbeat_timeout_s: float | None = None
    sdo_timeout_s: float | None = None

    @property
    def drives(self) -> tuple[int, ...]:
        """Node numbers of joints 1..n."""
        return tuple(joint.node for joint in self.joints)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Node numbers of the joints, and of the supervisor if there is one."""
        return self.drives if self.supervisor is None else (*self.drives, self.supervisor)

    @property
    def joint_of(self) -> dict[int, int]:
        """Joint by node number."""
        return {node: joint for joint, node in enumerate(self.drives, 1)}

    def is_drive(self, device_type: int) -> bool:
        """Whether 1000h is that of a drive that can be driven."""
        return device_type & self.device_type_mask == self.device_type & self.device_type_mask

    def mode_of(self, code: int) -> JointMode | None:
        """Joint mode of 6061h; None for neither position nor free."""
        return next((mode for mode, known in self.mode_codes.items() if known == code), None)

    def who(self, node: int) -> str:
        """Name a node."""
        joint = self.joint_of.get(node)
        return f"node {node}" if joint is None else f"joint {joint} (node {node})"


def map_words(entries: Iterable[Entry]) -> str:
    """Write a map as files and messages have it: ``6041h(16) + 6064h(32)``."""
    return " + ".join(map(entry_words, entries)) or "nothing"


def entry_words(entry: Entry) -> str:
    """Write one entry of a map."""
    index, sub, bits = entry
    return f"{index:04X}h{f' sub {sub}' if sub else ''}({bits})"

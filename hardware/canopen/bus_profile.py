"""Set-up of an arm's nodes on the bus: node numbers, PDOs, modes.

SYNC, EMCY, SDO and heartbeats use CiA 301's predefined connection set. A profile describes what the drive maker can
choose. Before anything is enabled, the profile is compared with every drive, or written into the drives.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from hardware.arm import JointMode
from hardware.canopen import objects

Entry = tuple[int, int, int]
"""Entry of a PDO map: index, sub-index, length in bits."""

COMMAND_OBJECTS: Final = (objects.CONTROLWORD, objects.TARGET_POSITION, objects.MODE)
"""Objects that the RPDOs of a joint carry together."""
FEEDBACK_OBJECTS: Final = (objects.STATUSWORD, objects.POSITION_ACTUAL, objects.TORQUE_ACTUAL)
"""Objects that the TPDOs of a joint carry together on every SYNC."""
ZERO_OBJECTS: Final = frozenset({0x6071, 0x60B0, 0x60B1, 0x60B2, 0x60FF, *range(0x0001, 0x0020)})
"""Further objects allowed in an RPDO, always sent as 0: target torque, velocity, offsets, dummy entries."""
FIELD_BITS: Final = (8, 16, 32, 64)
"""Allowed widths in bits of command and feedback objects; other mapped objects may have any whole number of bytes."""
MAX_HEARTBEAT_MS: Final = 10_000
"""Upper bound of `slowest_heartbeat_ms` in any profile."""
DEFAULT_HEARTBEAT_LIMIT_MS: Final = 1000
DEFAULT_ENABLING_TIMEOUT_S: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class PdoKind:
    """Kind of PDO: RPDO or TPDO. PDO 1 has the objects `communication` and `mapping`, and COB-ID `cob_id` + node."""

    name: str
    communication: int
    mapping: int
    cob_id: int
    transmission_types: tuple[int, ...]
    transmission: str
    """Transmission types allowed, as numbers and in words; a drive with another type is set to the last number."""
    carried: tuple[int, ...]
    """Objects that the PDOs of a joint carry together."""

    def records(self, number: int) -> tuple[int, int]:
        """Return the object indices of the communication record and of the map of PDO `number` (1 is the first)."""
        return self.communication + number - 1, self.mapping + number - 1


RPDO: Final = PdoKind(
    "RPDO",
    objects.RPDO1_COMMUNICATION,
    objects.RPDO1_MAP,
    objects.COB_RPDO1,
    (254, 255),  # STOP must not wait for a SYNC
    "acted on when received",
    COMMAND_OBJECTS,
)
TPDO: Final = PdoKind(
    "TPDO",
    objects.TPDO1_COMMUNICATION,
    objects.TPDO1_MAP,
    objects.COB_TPDO1,
    (objects.TPDO_EVERY_SYNC,),
    "on every SYNC",
    FEEDBACK_OBJECTS,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pdo:
    """One PDO of one joint: number (1 for 1400h/1600h or 1800h/1A00h), identifier and map."""

    number: int
    cob_id: int
    entries: tuple[Entry, ...]

    @property
    def carried(self) -> frozenset[int]:
        """Indices of the objects that the PDO carries."""
        return frozenset(index for index, _, _ in self.entries)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointProfile:
    """Set-up of one joint's drive on the bus."""

    node: int
    commands: tuple[Pdo, ...]
    answers: tuple[Pdo, ...]
    """RPDOs (`commands`) and TPDOs (`answers`) that are used."""
    direction: int = 1
    """-1 if the drive counts against the positive direction of the arm file, otherwise 1."""
    counts_per_rev: float | None = None
    """Position units of the drive per turn of the joint; None uses the arm file's sensor."""
    zero_counts: int = 0
    """Value of 6064h (actual position) at sensor coordinate 0."""
    rated_torque_nm: float | None = None
    """Torque that 6077h reports as 1000 per mille; if None, it is read from 6076h (rated torque)."""

    @property
    def pdos(self) -> tuple[tuple[PdoKind, tuple[Pdo, ...]], ...]:
        """PDOs used, by kind."""
        return (RPDO, self.commands), (TPDO, self.answers)


@dataclass(frozen=True, slots=True, kw_only=True)
class BusProfile:
    """Set-up of the nodes of an arm with joints 1..n."""

    name: str
    joints: tuple[JointProfile, ...]
    supervisor: int | None
    """Node that identifies the arm, grants control and stores parameters; None if there is none."""
    serial_number: str = ""
    """Serial number of an arm without supervisor."""
    device_type: int = objects.DRIVE_DEVICE_TYPE
    device_type_mask: int = objects.DEVICE_TYPE_MASK
    """Value of 1000h required of every drive (`device_type`), compared only in the bits of `device_type_mask`."""
    mode_codes: Mapping[JointMode, int] = field(
        default_factory=lambda: MappingProxyType(objects.MODE_CODE)
    )
    """Value of 6060h for each joint mode."""
    configures_pdos: bool = False
    """Whether PDOs that differ from the profile are rewritten at every connection; if not, the drive is refused."""
    compared: frozenset[int] = frozenset()
    """Objects that are compared with the arm file."""
    slowest_heartbeat_ms: int = DEFAULT_HEARTBEAT_LIMIT_MS
    """Upper limit of 1017h: the loss of a node with a longer period would be noticed too late."""
    enabling_timeout_s: float = DEFAULT_ENABLING_TIMEOUT_S
    """Time allowed for all drives to pass from *switch on disabled* to *operation enabled*."""
    heartbeat_timeout_s: float | None = None
    sdo_timeout_s: float | None = None
    """Time-outs for this arm, `heartbeat_timeout_s` and `sdo_timeout_s`; None uses the program's default."""

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
        """Joint of each node number."""
        return {node: joint for joint, node in enumerate(self.drives, 1)}

    def is_drive(self, device_type: int) -> bool:
        """Whether a node with this value of 1000h is a supported drive."""
        return device_type & self.device_type_mask == self.device_type & self.device_type_mask

    def mode_of(self, code: int) -> JointMode | None:
        """Return the joint mode of a 6061h value; None if the value stands for neither position nor free."""
        return next((mode for mode, known in self.mode_codes.items() if known == code), None)

    def who(self, node: int) -> str:
        """Return the name of a node for messages, e.g. ``joint 1 (node 1)``."""
        joint = self.joint_of.get(node)
        return f"node {node}" if joint is None else f"joint {joint} (node {node})"


def format_map(entries: Iterable[Entry]) -> str:
    """Format a PDO map, e.g. ``6041h(16) + 6064h(32)``."""
    return " + ".join(map(format_entry, entries)) or "nothing"


def format_entry(entry: Entry) -> str:
    """Format one entry of a PDO map, e.g. ``6064h(32)`` or ``6091h sub 1(32)``."""
    index, sub, bits = entry
    return f"{index:04X}h{f' sub {sub}' if sub else ''}({bits})"

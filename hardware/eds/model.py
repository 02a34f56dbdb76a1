"""What an object dictionary consists of, as data. Knows the words of CiA 301 and CiA 306, no object."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum


class DataType(IntEnum):
    """Data types of CiA 301, by their index."""

    INTEGER8 = 0x02
    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    VISIBLE_STRING = 0x09
    OCTET_STRING = 0x0A
    DOMAIN = 0x0F


class ObjectKind(IntEnum):
    """Object codes of CiA 301."""

    DOMAIN = 2
    VARIABLE = 7
    ARRAY = 8
    RECORD = 9


class Access(Enum):
    """Access types of CiA 306."""

    READ_ONLY = "ro"
    READ_WRITE = "rw"
    WRITE_ONLY = "wo"
    CONSTANT = "const"


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One sub-index, or the only one of a variable.

    Attributes
    ----------
    default
        Value after power-up; None where there is none to state.
    plus_node
        The node number is added to the default (``$NODEID``).
    lowest, highest
        Range the device accepts; None for the whole type.
    mappable
        May be mapped into a PDO.
    """

    name: str
    type: DataType
    access: Access = Access.READ_ONLY
    default: int | str | None = None
    plus_node: bool = False
    lowest: int | None = None
    highest: int | None = None
    mappable: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class DictionaryObject:
    """One index. `entries` maps sub-indices; a variable has sub-index 0 only."""

    index: int
    name: str
    kind: ObjectKind
    entries: tuple[tuple[int, Entry], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """A device type: what its EDS says. Baud rates in kbit/s."""

    file_name: str
    product_name: str
    vendor_number: int
    product_number: int
    revision_number: int
    rx_pdos: int
    tx_pdos: int
    objects: tuple[DictionaryObject, ...]


def variable(index: int, entry: Entry) -> DictionaryObject:
    """Object with one value."""
    kind = ObjectKind.DOMAIN if entry.type is DataType.DOMAIN else ObjectKind.VARIABLE
    return DictionaryObject(index=index, name=entry.name, kind=kind, entries=((0, entry),))


def structure(
    index: int,
    name: str,
    *members: Entry,
    kind: ObjectKind = ObjectKind.RECORD,
    count_access: Access = Access.CONSTANT,
    count: int | None = None,
) -> DictionaryObject:
    """Record or array with members 1..n; sub-index 0 says how many there are.

    `count` is what sub-index 0 says at power-up if that differs from the number of members.
    """
    head = Entry(
        name="Highest sub-index supported",
        type=DataType.UNSIGNED8,
        access=count_access,
        default=len(members) if count is None else count,
    )
    return DictionaryObject(
        index=index, name=name, kind=kind, entries=((0, head), *enumerate(members, start=1))
    )

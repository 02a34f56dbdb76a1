"""Which PDOs a drive uses, and in which objects it describes itself, read by SDO. Changes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from hardware.canopen.bus_profile import ANSWERED, COMMANDED, Entry
from hardware.canopen.maps import IDENTIFIER, NOT_VALID, read_map, read_number, read_records
from hardware.canopen.objects import (
    CONTROL_PERIOD,
    ENCODER_RESOLUTION,
    POSITION_LIMITS,
    RPDO1_COMMUNICATION,
    RPDO1_MAP,
    SENSOR,
    TPDO1_COMMUNICATION,
    TPDO1_MAP,
)
from hardware.errors import SdoRefused

if TYPE_CHECKING:
    from hardware.canopen.sdo import ObjectAccess

DESCRIBING: Final = (POSITION_LIMITS, ENCODER_RESOLUTION, CONTROL_PERIOD, SENSOR)
"""What can be compared with an arm file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundPdo:
    """A PDO in use: `sent` by the drive or taken by it, its number, identifier, type and map."""

    sent: bool
    number: int
    cob_id: int
    transmission: int
    entries: tuple[Entry, ...]

    @property
    def name(self) -> str:
        """``TPDO1``, ``RPDO3``."""
        return f"{'T' if self.sent else 'R'}PDO{self.number}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PdoRoom:
    """What a drive's PDOs could be set up of: numbers of those it takes and sends, used or not, and objects' bits."""

    taken: tuple[int, ...] = ()
    sent: tuple[int, ...] = ()
    bits: tuple[tuple[int, int], ...] = ()


NO_ROOM: Final = PdoRoom()


def read_room(access: ObjectAccess, node: int) -> PdoRoom:
    """Read which PDOs a drive has, and how wide the objects are that have to be in them."""
    bits = []
    for index in (*COMMANDED, *ANSWERED):
        try:
            bits.append((index, 8 * len(access.read(node, index))))
        except SdoRefused:
            continue
    taken, sent = (
        tuple(number for number, _ in read_records(access, node, first))
        for first in (RPDO1_COMMUNICATION, TPDO1_COMMUNICATION)
    )
    return PdoRoom(taken=taken, sent=sent, bits=tuple(bits))


def read_pdos(access: ObjectAccess, node: int) -> tuple[FoundPdo, ...]:
    """Read the PDOs of a drive that are in use, those it takes first."""
    return (*_pdos(access, node, sent=False), *_pdos(access, node, sent=True))


def read_described(access: ObjectAccess, node: int) -> tuple[int, ...]:
    """Which of the objects that can be compared with an arm file a drive has."""
    found = []
    for index in DESCRIBING:
        try:
            access.read(node, index, 1)
        except SdoRefused:
            continue
        found.append(index)
    return tuple(found)


def _pdos(access: ObjectAccess, node: int, *, sent: bool) -> Iterator[FoundPdo]:
    communication, mapping = (
        (TPDO1_COMMUNICATION, TPDO1_MAP) if sent else (RPDO1_COMMUNICATION, RPDO1_MAP)
    )
    for number, cob_id in read_records(access, node, communication):
        if cob_id & NOT_VALID:
            continue
        at = number - 1
        transmission = read_number(access, node, communication + at, 2)
        yield FoundPdo(
            sent=sent,
            number=number,
            cob_id=cob_id & IDENTIFIER,
            transmission=255 if transmission is None else transmission,
            entries=read_map(access, node, mapping + at) or (),
        )

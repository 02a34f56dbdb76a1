"""Reads by SDO which PDOs a drive uses and could use, and in which objects it describes itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from hardware.canopen.bus_profile import COMMAND_OBJECTS, FEEDBACK_OBJECTS, Entry
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

DESCRIPTION_OBJECTS: Final = (POSITION_LIMITS, ENCODER_RESOLUTION, CONTROL_PERIOD, SENSOR)
"""Objects that can be compared with an arm file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActivePdo:
    """A valid PDO of a drive: a TPDO if `sent`, else an RPDO; its number, identifier, type and map."""

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
class PdoCapability:
    """Numbers of a drive's RPDOs (`taken`) and TPDOs (`sent`), valid or not, and bits of each object to be mapped."""

    taken: tuple[int, ...] = ()
    sent: tuple[int, ...] = ()
    bits: tuple[tuple[int, int], ...] = ()


NO_PDO_CAPABILITY: Final = PdoCapability()


def read_pdo_capability(access: ObjectAccess, node: int) -> PdoCapability:
    """Read which PDOs a drive has, and the widths of the objects to be mapped."""
    bits = []
    for index in (*COMMAND_OBJECTS, *FEEDBACK_OBJECTS):
        try:
            bits.append((index, 8 * len(access.read(node, index))))
        except SdoRefused:
            continue
    rpdos, tpdos = (
        tuple(number for number, _ in read_records(access, node, first))
        for first in (RPDO1_COMMUNICATION, TPDO1_COMMUNICATION)
    )
    return PdoCapability(taken=rpdos, sent=tpdos, bits=tuple(bits))


def read_pdos(access: ObjectAccess, node: int) -> tuple[ActivePdo, ...]:
    """Read the valid PDOs of a drive, RPDOs first."""
    return (*_pdos(access, node, sent=False), *_pdos(access, node, sent=True))


def read_description_objects(access: ObjectAccess, node: int) -> tuple[int, ...]:
    """Those of `DESCRIPTION_OBJECTS` that a drive has."""
    found = []
    for index in DESCRIPTION_OBJECTS:
        try:
            access.read(node, index, 1)
        except SdoRefused:
            continue
        found.append(index)
    return tuple(found)


def _pdos(access: ObjectAccess, node: int, *, sent: bool) -> Iterator[ActivePdo]:
    communication, mapping = (
        (TPDO1_COMMUNICATION, TPDO1_MAP) if sent else (RPDO1_COMMUNICATION, RPDO1_MAP)
    )
    for number, cob_id in read_records(access, node, communication):
        if cob_id & NOT_VALID:
            continue
        at = number - 1
        transmission = read_number(access, node, communication + at, 2)
        yield ActivePdo(
            sent=sent,
            number=number,
            cob_id=cob_id & IDENTIFIER,
            transmission=255 if transmission is None else transmission,
            entries=read_map(access, node, mapping + at) or (),
        )

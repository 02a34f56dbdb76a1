"""Writes the PDOs of a bus profile into drives that hold others, where the profile asks for it. Moves nothing.

By the procedure of CiA 301, in pre-operational: the PDO is made invalid, its map emptied, filled and counted,
then it is made valid again. What is equal already is not touched. Nothing is stored (1010h): a drive that is
switched off, or whose communication is reset, has what it had before. `hardware.canopen.maps` compares afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from hardware.canopen.bus_profile import BusProfile, Entry, Pdo, map_words
from hardware.canopen.maps import (
    EVERY_SYNC,
    EXTENDED,
    GENERATES_SYNC,
    IDENTIFIER,
    INHIBIT,
    LONGEST_INHIBIT_S,
    NOT_VALID,
    ON_RECEIPT,
    SYNC_START,
    in_the_way,
    inhibit_s,
    read_map,
    read_number,
)
from hardware.canopen.objects import (
    RPDO1_COMMUNICATION,
    RPDO1_MAP,
    TPDO1_COMMUNICATION,
    TPDO1_MAP,
    NmtCommand,
)
from hardware.canopen.sdo import ObjectAccess
from hardware.errors import BusError, NotConfigured, ObjectMismatch, SdoRefused

_NO_REMOTE_REQUEST: Final = GENERATES_SYNC
"""In a PDO's identifier, bit 30 says that it is not sent for a remote request: left as the drive has it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Write:
    """One value for one sub-index, `size` bytes wide; `why` ends the sentence of a refusal."""

    node: int
    index: int
    sub: int
    value: int
    size: int
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One PDO of one drive that has to become another: what it was and will be, and the writes in order."""

    words: str
    invalidate: tuple[Write, ...]
    set_up: tuple[Write, ...]
    validate: tuple[Write, ...]


def configure(
    access: ObjectAccess, profile: BusProfile, command: Callable[[NmtCommand], None]
) -> tuple[str, ...]:
    """Make the drives' PDOs those of the profile; `command` sends an NMT command to all nodes.

    Returns
    -------
    What was changed, a sentence for each PDO; none where all was as it has to be.

    Raises
    ------
    NotConfigured
        A drive has no such PDO, or refuses it. All drives are back at what they hold of their own.
    """
    changes = plan(access, profile)
    if not changes:
        return ()
    command(NmtCommand.ENTER_PRE_OPERATIONAL)  # some start by themselves
    try:
        # All invalid first: two PDOs of a drive may change identifiers.
        for step in ("invalidate", "set_up", "validate"):
            for change in changes:
                for write in getattr(change, step):
                    _write(access, profile, write)
    except BaseException:
        with suppress(BusError):  # half a map is nobody's
            command(NmtCommand.RESET_COMMUNICATION)
        raise
    return tuple(change.words for change in changes)


def plan(access: ObjectAccess, profile: BusProfile) -> tuple[Change, ...]:
    """What has to be written; reads only.

    Raises
    ------
    NotConfigured
        A drive has no such PDO.
    """
    changes, lacking = list[Change](), list[str]()
    for joint in profile.joints:
        for number, index, value in in_the_way(access, joint.node, profile, joint):
            who = f"{profile.who(joint.node)}: {_name(index, number)}"
            words = f"{who} is off; it was on {value & IDENTIFIER:03X}h, which this arm needs"
            changes.append(
                Change(
                    words=words,
                    invalidate=(_invalidate(joint.node, index, value),),
                    set_up=(),
                    validate=(),
                )
            )
        for communication, mapping, types, pdos in (
            (RPDO1_COMMUNICATION, RPDO1_MAP, ON_RECEIPT, joint.commands),
            (TPDO1_COMMUNICATION, TPDO1_MAP, EVERY_SYNC, joint.answers),
        ):
            for pdo in pdos:
                at = pdo.number - 1
                found = _Found.read(access, joint.node, communication + at, mapping + at)
                if isinstance(found, str):
                    lacking.append(found)
                else:
                    changes += found.change_to(pdo, types, profile.who(joint.node))
    if lacking:
        raise NotConfigured(lacking)
    return tuple(changes)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """A PDO as a drive holds it: the indices of its two records, and what is in them."""

    node: int
    communication: int
    mapping: int
    cob_id: int
    transmission: int
    inhibited: bool
    starts_late: bool
    entries: tuple[Entry, ...]

    @classmethod
    def read(
        cls, access: ObjectAccess, node: int, communication: int, mapping: int
    ) -> _Found | str:
        """Read both records; a sentence where one is not there."""
        cob_id = read_number(access, node, communication, 1)
        entries = read_map(access, node, mapping)
        for index, there in ((communication, cob_id), (mapping, entries)):
            if there is None:
                expected, found = "a PDO to set up", "no such object"
                return str(ObjectMismatch(node=node, index=index, expected=expected, found=found))
        return cls(
            node=node,
            communication=communication,
            mapping=mapping,
            cob_id=cob_id or 0,
            transmission=read_number(access, node, communication, 2) or 0,
            inhibited=inhibit_s(access, node, communication) >= LONGEST_INHIBIT_S,
            starts_late=bool(read_number(access, node, communication, SYNC_START)),
            entries=entries or (),
        )

    def change_to(self, pdo: Pdo, types: tuple[int, ...], who: str) -> Iterator[Change]:
        """Nothing where it is that PDO already."""
        writes = list[Write]()
        if self.entries != pdo.entries:
            why = f"its map was to be {map_words(pdo.entries)}"
            entries = [index << 16 | sub << 8 | bits for index, sub, bits in pdo.entries]
            writes.append(self._write(self.mapping, 0, 0, 1, why))
            writes += (
                self._write(self.mapping, at, entry, 4, why) for at, entry in enumerate(entries, 1)
            )
            writes.append(self._write(self.mapping, 0, len(entries), 1, why))
        if self.transmission not in types:
            why = f"its transmission type was to be {types[-1]}"
            writes.append(self._write(self.communication, 2, types[-1], 1, why))
        if types is EVERY_SYNC and self.inhibited:
            why = "its inhibit time was to be 0"
            writes.append(self._write(self.communication, INHIBIT, 0, 2, why))
        if types is EVERY_SYNC and self.starts_late:
            why = "its SYNC start value was to be 0"
            writes.append(self._write(self.communication, SYNC_START, 0, 1, why))
        moved = self.cob_id & (IDENTIFIER | EXTENDED | NOT_VALID) != pdo.cob_id
        if not writes and not moved:
            return
        value = self.cob_id & _NO_REMOTE_REQUEST | pdo.cob_id
        why = f"its identifier was to be {pdo.cob_id:03X}h"
        valid = not self.cob_id & NOT_VALID
        yield Change(
            words=f"{who}: {_name(self.communication, pdo.number)} is {map_words(pdo.entries)} on "
            f"{pdo.cob_id:03X}h; it was {self._words()}",
            invalidate=(_invalidate(self.node, self.communication, self.cob_id),) if valid else (),
            set_up=tuple(writes),
            validate=(self._write(self.communication, 1, value, 4, why),),
        )

    def _write(self, index: int, sub: int, value: int, size: int, why: str) -> Write:
        return Write(node=self.node, index=index, sub=sub, value=value, size=size, why=why)

    def _words(self) -> str:
        off = "off, " if self.cob_id & NOT_VALID else ""
        also = f"{', inhibited' * self.inhibited}{', with a SYNC start value' * self.starts_late}"
        return (
            f"{off}{map_words(self.entries)} on {self.cob_id & IDENTIFIER:03X}h, type "
            f"{self.transmission}{also}"
        )


def _invalidate(node: int, communication: int, cob_id: int) -> Write:
    value, why = cob_id | NOT_VALID, "it was to be switched off while it is set up"
    return Write(node=node, index=communication, sub=1, value=value, size=4, why=why)


def _name(communication: int, number: int) -> str:
    return f"{'T' if communication >= TPDO1_COMMUNICATION else 'R'}PDO{number}"


def _write(access: ObjectAccess, profile: BusProfile, write: Write) -> None:
    try:
        access.write_unsigned(write.node, write.index, write.sub, write.value, write.size)
    except SdoRefused as refusal:
        raise NotConfigured([f"{profile.who(write.node)}: {refusal}; {write.why}"]) from refusal

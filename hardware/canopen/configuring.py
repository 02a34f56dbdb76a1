"""Writes a bus profile's PDOs into the drives, and 0 into torques and offsets that drives would add to commands.

PDOs by the procedure of CiA 301 in pre-operational: PDO invalid, map count 0, entries, count, PDO valid.
PDOs that are already right are left alone. Nothing is stored (1010h), so a communication reset restores the drive's own
PDOs. `hardware.canopen.maps` compares afterwards. Torques and offsets are read before anything is enabled: in free mode
a joint obeys a target torque and its offset, which our RPDOs may not carry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from hardware.canopen.bus_profile import BusProfile, Entry, JointProfile, Pdo, format_map
from hardware.canopen.maps import (
    ABSENT,
    EVERY_SYNC,
    EXTENDED,
    GENERATES_SYNC,
    IDENTIFIER,
    INHIBIT,
    MAX_INHIBIT_S,
    NOT_VALID,
    ON_RECEIPT,
    SYNC_START,
    conflicting_pdos,
    inhibit_s,
    read_map,
    read_number,
)
from hardware.canopen.objects import (
    POSITION_OFFSET,
    RPDO1_COMMUNICATION,
    RPDO1_MAP,
    TARGET_TORQUE,
    TORQUE_OFFSET,
    TPDO1_COMMUNICATION,
    TPDO1_MAP,
    NmtCommand,
)
from hardware.canopen.sdo import ObjectAccess
from hardware.errors import (
    BusError,
    MappingMismatch,
    ObjectMismatch,
    PdoSetupFailed,
    ProfileRemedy,
    SdoRefused,
    ZeroingFailed,
)

_NO_REMOTE_REQUEST: Final = GENERATES_SYNC
"""Bit 30 of a PDO's identifier (no remote request): kept as the drive has it."""
_ADDED_OBJECTS: Final = (TARGET_TORQUE, TORQUE_OFFSET, POSITION_OFFSET)
"""Objects that a drive adds to its commands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectWrite:
    """One value for one sub-index, `size` bytes wide; `why` is the end of the message if it is refused."""

    node: int
    index: int
    sub: int
    value: int
    size: int
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PdoChange:
    """Change of one PDO of one drive: its description, and the writes in order."""

    text: str
    invalidate: tuple[ObjectWrite, ...]
    set_up: tuple[ObjectWrite, ...] = ()
    validate: tuple[ObjectWrite, ...] = ()


def configure(
    access: ObjectAccess, profile: BusProfile, command: Callable[[NmtCommand], None]
) -> tuple[str, ...]:
    """Write the profile's PDOs into the drives; `command` sends an NMT command to all nodes.

    Returns one sentence for each changed PDO. Raises `PdoSetupFailed` if a drive lacks or refuses a PDO; the
    drives are then reset to their own PDOs.
    """
    changes = plan_changes(access, profile)
    if not changes:
        return ()
    command(NmtCommand.ENTER_PRE_OPERATIONAL)  # some drives start by themselves
    try:
        # All invalid first: two PDOs of a drive may swap identifiers.
        for step in ("invalidate", "set_up", "validate"):
            for change in changes:
                for write in getattr(change, step):
                    _write(access, profile, write)
    except BaseException:
        with suppress(BusError):
            command(NmtCommand.RESET_COMMUNICATION)
        raise
    return tuple(change.text for change in changes)


def zero_residual_torques(access: ObjectAccess, profile: BusProfile) -> Iterator[str]:
    """Check that every drive adds 0 to its commands; write 0 where the profile configures drives.

    Yields one sentence for each object written. Raises `MappingMismatch` naming every object that is not 0,
    if the profile only compares, and `ZeroingFailed` if a drive refuses the 0.
    """
    nonzero = [found for joint in profile.joints for found in _nonzero_objects(access, joint)]
    if nonzero and not profile.configures_pdos:
        raise MappingMismatch(
            [
                ObjectMismatch(
                    node=node,
                    index=index,
                    expected="0",
                    found=str(value),
                    remedy=ProfileRemedy.SEND_ZERO,
                )
                for node, index, value, _ in nonzero
            ]
        )
    for node, index, value, size in nonzero:
        who = profile.who(node)
        try:
            access.write_unsigned(node, index, 0, 0, size)
        except SdoRefused as refusal:
            raise ZeroingFailed([f"{who}: {refusal}; the required value is 0"]) from refusal
        yield f"{who}: {index:04X}h is 0; it was {value}"


def _nonzero_objects(
    access: ObjectAccess, joint: JointProfile
) -> Iterator[tuple[int, int, int, int]]:
    """Node, index, value and size in bytes of objects that are not 0 and not sent as 0 in an RPDO."""
    sent = frozenset[int]().union(*(pdo.carried for pdo in joint.commands))
    for index in _ADDED_OBJECTS:
        if index in sent:
            continue
        try:
            data = access.read(joint.node, index)
        except SdoRefused as refusal:
            if refusal.code in ABSENT:
                continue
            raise
        if value := int.from_bytes(data, "little", signed=True):
            yield joint.node, index, value, len(data)


def plan_changes(access: ObjectAccess, profile: BusProfile) -> tuple[PdoChange, ...]:
    """Changes to be written; reads only. `PdoSetupFailed` if a drive has no such PDO."""
    changes, missing = list[PdoChange](), list[str]()
    for joint in profile.joints:
        for number, index, value in conflicting_pdos(access, joint.node, profile, joint):
            who = f"{profile.who(joint.node)}: {_name(index, number)}"
            text = f"{who} was on {value & IDENTIFIER:03X}h, an identifier of this arm, and is switched off"
            changes.append(
                PdoChange(text=text, invalidate=(_invalidate(joint.node, index, value),))
            )
        for communication, mapping, types, pdos in (
            (RPDO1_COMMUNICATION, RPDO1_MAP, ON_RECEIPT, joint.commands),
            (TPDO1_COMMUNICATION, TPDO1_MAP, EVERY_SYNC, joint.answers),
        ):
            for pdo in pdos:
                at = pdo.number - 1
                found = _CurrentPdo.read(access, joint.node, communication + at, mapping + at)
                if isinstance(found, str):
                    missing.append(found)
                else:
                    changes += found.change_to(pdo, types, profile.who(joint.node))
    if missing:
        raise PdoSetupFailed(missing)
    return tuple(changes)


@dataclass(frozen=True, slots=True, kw_only=True)
class _CurrentPdo:
    """A PDO as the drive has it: indices of its two records, and their content."""

    node: int
    communication: int
    mapping: int
    cob_id: int
    transmission: int
    inhibited: bool
    has_sync_start: bool
    entries: tuple[Entry, ...]

    @classmethod
    def read(
        cls, access: ObjectAccess, node: int, communication: int, mapping: int
    ) -> _CurrentPdo | str:
        """Read both records; return a sentence if one does not exist."""
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
            inhibited=inhibit_s(access, node, communication) >= MAX_INHIBIT_S,
            has_sync_start=bool(read_number(access, node, communication, SYNC_START)),
            entries=entries or (),
        )

    def change_to(self, pdo: Pdo, types: tuple[int, ...], who: str) -> Iterator[PdoChange]:
        """Yield the change to `pdo`, if it differs."""
        writes = list[ObjectWrite]()
        if self.entries != pdo.entries:
            why = f"required map: {format_map(pdo.entries)}"
            entries = [index << 16 | sub << 8 | bits for index, sub, bits in pdo.entries]
            writes.append(self._write(self.mapping, 0, 0, 1, why))
            writes += (
                self._write(self.mapping, at, entry, 4, why) for at, entry in enumerate(entries, 1)
            )
            writes.append(self._write(self.mapping, 0, len(entries), 1, why))
        if self.transmission not in types:
            why = f"required transmission type: {types[-1]}"
            writes.append(self._write(self.communication, 2, types[-1], 1, why))
        if types is EVERY_SYNC and self.inhibited:
            why = "required inhibit time: 0"
            writes.append(self._write(self.communication, INHIBIT, 0, 2, why))
        if types is EVERY_SYNC and self.has_sync_start:
            why = "required SYNC start value: 0"
            writes.append(self._write(self.communication, SYNC_START, 0, 1, why))
        moved = self.cob_id & (IDENTIFIER | EXTENDED | NOT_VALID) != pdo.cob_id
        if not writes and not moved:
            return
        value = self.cob_id & _NO_REMOTE_REQUEST | pdo.cob_id
        why = f"required identifier: {pdo.cob_id:03X}h"
        valid = not self.cob_id & NOT_VALID
        yield PdoChange(
            text=f"{who}: {_name(self.communication, pdo.number)} is {format_map(pdo.entries)} on "
            f"{pdo.cob_id:03X}h; it was {self._describe()}",
            invalidate=(_invalidate(self.node, self.communication, self.cob_id),) if valid else (),
            set_up=tuple(writes),
            validate=(self._write(self.communication, 1, value, 4, why),),
        )

    def _write(self, index: int, sub: int, value: int, size: int, why: str) -> ObjectWrite:
        return ObjectWrite(node=self.node, index=index, sub=sub, value=value, size=size, why=why)

    def _describe(self) -> str:
        off = "off, " if self.cob_id & NOT_VALID else ""
        also = (
            f"{', inhibited' * self.inhibited}{', with a SYNC start value' * self.has_sync_start}"
        )
        return (
            f"{off}{format_map(self.entries)} on {self.cob_id & IDENTIFIER:03X}h, type "
            f"{self.transmission}{also}"
        )


def _invalidate(node: int, communication: int, cob_id: int) -> ObjectWrite:
    value, why = cob_id | NOT_VALID, "it must be switched off while it is set up"
    return ObjectWrite(node=node, index=communication, sub=1, value=value, size=4, why=why)


def _name(communication: int, number: int) -> str:
    return f"{'T' if communication >= TPDO1_COMMUNICATION else 'R'}PDO{number}"


def _write(access: ObjectAccess, profile: BusProfile, write: ObjectWrite) -> None:
    try:
        access.write_unsigned(write.node, write.index, write.sub, write.value, write.size)
    except SdoRefused as refusal:
        raise PdoSetupFailed([f"{profile.who(write.node)}: {refusal}; {write.why}"]) from refusal

"""Writes a bus profile's PDOs into the drives, and sets to 0 torques and offsets that drives would add to commands.

In pre-operational, a PDO is made invalid, its map count is set to 0, entries and count are written, and the PDO is made
valid (CiA 301). PDOs that already agree are not written. Nothing is stored (1010h), so a communication reset restores
the drive's own PDOs. `hardware.canopen.maps` compares the PDOs after writing. Torques and offsets are read before
anything is enabled: in free mode a joint obeys target torque and torque offset, which the RPDOs need not carry.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from hardware import errors
from hardware.canopen import maps
from hardware.canopen.bus_profile import TPDO, BusProfile, JointProfile, Pdo, PdoKind, format_map
from hardware.canopen.objects import POSITION_OFFSET, TARGET_TORQUE, TORQUE_OFFSET, NmtCommand
from hardware.canopen.sdo import ObjectAccess

_NO_REMOTE_REQUEST: Final = maps.GENERATES_SYNC
"""Bit 30 of a PDO's COB-ID (no remote request), which is left as it is in the drive."""
_ADDED_OBJECTS: Final = (TARGET_TORQUE, TORQUE_OFFSET, POSITION_OFFSET)
"""Objects that a drive adds to its commands."""


ObjectWrite = tuple[int, int, int, int, str]
"""Index, sub-index, value, size in bytes, and the requirement, as text for the error if the drive refuses."""


@dataclass(frozen=True, slots=True)
class PdoChange:
    """Change of one PDO. `text` is a sentence; the writes of `steps` make the PDO invalid, set it up, make it valid."""

    text: str
    node: int
    steps: tuple[Sequence[ObjectWrite], Sequence[ObjectWrite], Sequence[ObjectWrite]]


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
        # First all PDOs are made invalid: two PDOs of a drive may swap identifiers.
        for step in range(3):
            for change in changes:
                for index, sub, value, size, purpose in change.steps[step]:
                    try:
                        access.write_unsigned(change.node, index, sub, value, size)
                    except errors.SdoRefused as refusal:
                        who = profile.who(change.node)
                        raise errors.PdoSetupFailed([f"{who}: {refusal}; {purpose}"]) from refusal
    except BaseException:
        with suppress(errors.BusError):
            command(NmtCommand.RESET_COMMUNICATION)
        raise
    return tuple(change.text for change in changes)


def zero_residual_torques(access: ObjectAccess, profile: BusProfile) -> Iterator[str]:
    """Ensure that no drive adds a torque or an offset to its commands.

    If the profile configures PDOs, sets each object that is not 0 to 0 and yields one sentence about it; raises
    `ZeroingFailed` if a drive refuses. Otherwise raises `MappingMismatch`, with every object that is not 0.
    """
    nonzero = [each for joint in profile.joints for each in _nonzero_objects(access, joint)]
    if nonzero and not profile.configures_pdos:
        remedy = errors.ProfileRemedy.SEND_ZERO
        raise errors.MappingMismatch(
            [
                errors.ObjectMismatch(node, index, None, "0", str(value), remedy)
                for node, index, value, _ in nonzero
            ]
        )
    for node, index, value, size in nonzero:
        who = profile.who(node)
        try:
            access.write_unsigned(node, index, 0, 0, size)
        except errors.SdoRefused as refusal:
            raise errors.ZeroingFailed([f"{who}: {refusal}; the required value is 0"]) from refusal
        yield f"{who}: {index:04X}h is 0; it was {value}"


def _nonzero_objects(
    access: ObjectAccess, joint: JointProfile
) -> Iterator[tuple[int, int, int, int]]:
    """For each of `_ADDED_OBJECTS` that is not 0 and that no RPDO carries, yield node, index, value, size (bytes)."""
    sent = frozenset[int]().union(*(pdo.carried for pdo in joint.commands))
    for index in _ADDED_OBJECTS:
        if index in sent:
            continue
        data = maps.read_if_present(access.read, joint.node, index) or b""
        if value := int.from_bytes(data, "little", signed=True):
            yield joint.node, index, value, len(data)


def plan_changes(access: ObjectAccess, profile: BusProfile) -> tuple[PdoChange, ...]:
    """Return the changes that `configure` will write; `PdoSetupFailed` if a drive lacks a PDO."""
    changes, missing = list[PdoChange](), list[str]()
    for joint in profile.joints:
        for kind, number, value in maps.conflicting_pdos(access, joint.node, profile, joint):
            who = f"{profile.who(joint.node)}: {kind.name}{number}"
            text = f"{who} was on {value & maps.IDENTIFIER:03X}h, an identifier of this arm, and is switched off"
            invalid = _invalidate(kind.records(number)[0], value)
            changes.append(PdoChange(text, joint.node, ((invalid,), (), ())))
        for kind, pdos in joint.pdos:
            for pdo in pdos:
                change = _change(access, profile, joint.node, kind, pdo)
                if isinstance(change, str):
                    missing.append(change)
                elif change is not None:
                    changes.append(change)
    if missing:
        raise errors.PdoSetupFailed(missing)
    return tuple(changes)


def _change(
    access: ObjectAccess, profile: BusProfile, node: int, kind: PdoKind, pdo: Pdo
) -> PdoChange | str | None:
    """Return the change that sets up a PDO; None if no change is needed, a sentence if the PDO is absent."""
    communication, mapping = kind.records(pdo.number)
    cob_id = maps.read_number(access, node, communication, 1)
    entries = maps.read_map(access, node, mapping)
    if cob_id is None or entries is None:
        index = communication if cob_id is None else mapping
        return str(errors.ObjectMismatch(node, index, None, "a PDO to set up", "no such object"))
    transmission = maps.read_number(access, node, communication, 2) or 0
    inhibited = maps.inhibit_s(access, node, communication) >= maps.MAX_INHIBIT_S
    has_sync_start = bool(maps.read_number(access, node, communication, maps.SYNC_START))
    writes = list[ObjectWrite]()
    if entries != pdo.entries:
        reason = f"required map: {format_map(pdo.entries)}"
        writes.append((mapping, 0, 0, 1, reason))
        writes += (
            (mapping, at, index << 16 | sub << 8 | bits, 4, reason)
            for at, (index, sub, bits) in enumerate(pdo.entries, 1)
        )
        writes.append((mapping, 0, len(pdo.entries), 1, reason))
    *_, required = kind.transmission_types
    if transmission not in kind.transmission_types:
        writes.append((communication, 2, required, 1, f"required transmission type: {required}"))
    if kind is TPDO and inhibited:
        writes.append((communication, maps.INHIBIT, 0, 2, "required inhibit time: 0"))
    if kind is TPDO and has_sync_start:
        writes.append((communication, maps.SYNC_START, 0, 1, "required SYNC start value: 0"))
    if not writes and cob_id & (maps.IDENTIFIER | maps.EXTENDED | maps.NOT_VALID) == pdo.cob_id:
        return None
    invalid, new_id = bool(cob_id & maps.NOT_VALID), cob_id & _NO_REMOTE_REQUEST | pdo.cob_id
    text = (
        f"{profile.who(node)}: {kind.name}{pdo.number} is {format_map(pdo.entries)} on "
        f"{pdo.cob_id:03X}h; it was {'off, ' * invalid}{format_map(entries)} on {cob_id & maps.IDENTIFIER:03X}h, type "
        f"{transmission}{', inhibited' * inhibited}{', with a SYNC start value' * has_sync_start}"
    )
    valid = (communication, 1, new_id, 4, f"required identifier: {pdo.cob_id:03X}h")
    switch_off = () if invalid else (_invalidate(communication, cob_id),)
    return PdoChange(text, node, (switch_off, writes, (valid,)))


def _invalidate(communication: int, cob_id: int) -> ObjectWrite:
    purpose = "it must be switched off while it is set up"
    return communication, 1, cob_id | maps.NOT_VALID, 4, purpose

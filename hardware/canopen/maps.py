"""Reads the drives' PDOs by SDO before anything is enabled, and compares the PDOs with the bus profile.

A drive may answer every SYNC, but with its velocity in place of its position. Targets computed from such answers are
wrong. So all PDOs are compared. Afterwards the first position received by PDO is compared with 6064h read by SDO.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from hardware.arm_description import JointScale
from hardware.canopen import objects
from hardware.canopen.bus_profile import TPDO, BusProfile, Entry, JointProfile, PdoKind, format_map
from hardware.canopen.objects import Abort
from hardware.errors import MappingMismatch, ObjectMismatch, ProfileRemedy, SdoRefused

if TYPE_CHECKING:
    from hardware.canopen.sdo import ObjectAccess

POSITION_AGREEMENT_RAD = 0.01
"""Largest allowed difference of positions by PDO and SDO; covers RVDT noise, and creep between the two readings."""

NOT_VALID, EXTENDED, GENERATES_SYNC = 1 << 31, 1 << 29, 1 << 30
"""Flag bits of a COB-ID: the object is not valid; the identifier has 29 bits; the node generates SYNC (in 1005h)."""
IDENTIFIER = 0x1FFFFFFF
_SYNC_COUNTER = 0x1019
"""Synchronous counter overflow value; if not 0, SYNC carries a counter."""
MAX_PDOS, PDOS_PER_AXIS, MAX_ABSENT_PDOS = 512, 64, 16
"""CiA 301 has 512 PDOs in each direction, CiA 402 assigns 64 of them to each axis. To find which exist, the PDOs of
the first axis are read one by one until MAX_ABSENT_PDOS in a row are absent. The PDOs of every other axis are read in
the same way if the first of them exists."""
INHIBIT_S, MAX_INHIBIT_S = 1e-4, 0.5 * objects.CONTROL_PERIOD_S
"""Unit of the inhibit time in 1800h sub 3, and the inhibit time at and above which a TPDO may miss a SYNC."""
INHIBIT, SYNC_START = 3, 6
"""Sub-indices of 1800h: inhibit time, and SYNC start value."""
_RESERVED = frozenset(
    {
        objects.COB_NMT,
        *range(objects.COB_SYNC, objects.COB_EMCY + 0x80),
        *range(objects.COB_SDO_FROM_SERVER, objects.COB_SDO_TO_SERVER + 0x80),
        *range(objects.COB_HEARTBEAT, objects.COB_HEARTBEAT + 0x80),
    }
)
"""Identifiers of NMT, SYNC, and of EMCY, SDO and heartbeat of all nodes."""
ABSENT = frozenset({Abort.NO_OBJECT, Abort.NO_SUBINDEX})
_NO_INDEX = 0x0000
"""An index that no object has (CiA 301). Some drives refuse it, like any object that they lack, with a code not in
`ABSENT`."""
Value = TypeVar("Value")


def check_mapping(access: ObjectAccess, profile: BusProfile, silent: Iterable[int] = ()) -> None:
    """Compare the PDOs of all drives with the profile; nodes that are not drives are skipped.

    Raises `MappingMismatch` with node, object, expected and found value of every difference; the error also
    names the `silent` nodes.
    """
    absent = sorted(silent)
    differences = [
        text
        for node in profile.drives
        if node not in absent and profile.is_drive(access.read_unsigned(node, objects.DEVICE_TYPE))
        for text in pdo_differences(access, node, profile)
    ]
    if differences:
        raise MappingMismatch(differences, [f"{profile.who(node)}: no answer" for node in absent])


def check_positions(
    access: ObjectAccess, profile: BusProfile, counts: Sequence[int], scales: Sequence[JointScale]
) -> None:
    """Compare positions received by PDO (`counts`) with 6064h read by SDO, at rest; raises `MappingMismatch`."""
    differences = []
    for joint, by_pdo, scale in zip(profile.joints, counts, scales, strict=True):
        by_sdo = access.read_signed(joint.node, objects.POSITION_ACTUAL)
        if abs(by_pdo - by_sdo) > POSITION_AGREEMENT_RAD * scale.density + 1.0:
            index = objects.POSITION_ACTUAL
            carrier = next(pdo.number for pdo in joint.answers if index in pdo.carried)
            expected = f"{by_sdo} counts, as read by SDO"
            actual = f"{by_pdo} counts in TPDO{carrier}, which therefore carries something else"
            differences.append(ObjectMismatch(joint.node, index, None, expected, actual))
    if differences:
        raise MappingMismatch(differences)


def check_communication(access: ObjectAccess, profile: BusProfile) -> None:
    """Check the SYNC and EMCY objects, which no profile can change; raises `MappingMismatch`."""
    if differences := [text for node in profile.drives for text in _communication(access, node)]:
        raise MappingMismatch(differences)


def _communication(access: ObjectAccess, node: int) -> Iterator[ObjectMismatch]:
    none = ProfileRemedy.NONE
    for index, cob_id, refused in (
        (objects.SYNC_COB_ID, objects.COB_SYNC, GENERATES_SYNC),
        (objects.EMCY_COB_ID, objects.COB_EMCY + node, NOT_VALID),
    ):
        for mismatch in _cob_id(access, node, index, 0, cob_id, refused=refused):
            yield replace(mismatch, remedy=none)
    if counter := read_number(access, node, _SYNC_COUNTER, 0):
        expected = "0 (a SYNC without counter)"
        yield ObjectMismatch(node, _SYNC_COUNTER, 0, expected, f"{counter}", none)


def pdo_differences(
    access: ObjectAccess, node: int, profile: BusProfile
) -> Iterator[ObjectMismatch]:
    """Yield how a drive's PDOs differ from the bus profile or conflict with other frames of the arm."""
    yield from _communication(access, node)
    joint = profile.joints[profile.joint_of[node] - 1]
    for kind, pdo in ((kind, pdo) for kind, pdos in joint.pdos for pdo in pdos):
        communication, mapping = kind.records(pdo.number)
        yield from _cob_id(access, node, communication, 1, pdo.cob_id, refused=NOT_VALID)
        transmission = read_number(access, node, communication, 2)
        if transmission not in kind.transmission_types:
            expected = f"transmission type {' or '.join(map(str, kind.transmission_types))}"
            actual = "no such object" if transmission is None else str(transmission)
            # A drive that lacks this PDO needs a profile without it.
            remedy = ProfileRemedy.DESCRIBE_PDO if transmission is None else ProfileRemedy.WRITE_PDO
            yield ObjectMismatch(node, communication, 2, expected, actual, remedy)
        if kind is TPDO:
            yield from _on_every_sync(access, node, communication)
        entries = read_map(access, node, mapping)
        if entries != pdo.entries:
            expected = f"{kind.name}{pdo.number} = {format_map(pdo.entries)}"
            actual = "no such object" if entries is None else format_map(entries)
            yield ObjectMismatch(node, mapping, None, expected, actual)
    for kind, number, value in conflicting_pdos(access, node, profile, joint):
        index, cob_id = kind.records(number)[0], f"{value & IDENTIFIER:03X}h"
        expected = "an identifier that no other frame has, or bit 31 set (PDO off)"
        risk = "send this frame too" if kind is TPDO else "obey commands to another drive"
        actual = (
            f"{cob_id}, which is that of another frame of this arm, so that this drive could {risk}"
        )
        yield ObjectMismatch(node, index, 1, expected, actual, ProfileRemedy.WRITE_PDO)


def read_records(access: ObjectAccess, node: int, kind: PdoKind) -> Iterator[tuple[int, int]]:
    """Yield number and COB-ID (with flag bits) of every PDO of a kind."""
    for axis in range(0, MAX_PDOS, PDOS_PER_AXIS):
        absent = 0 if axis == 0 else MAX_ABSENT_PDOS - 1
        for at in range(axis, axis + PDOS_PER_AXIS):
            value = read_number(access, node, kind.communication + at, 1)
            if value is not None:
                yield at + 1, value
            absent = 0 if value is not None else absent + 1
            if absent == MAX_ABSENT_PDOS:
                break


def conflicting_pdos(
    access: ObjectAccess, node: int, profile: BusProfile, joint: JointProfile
) -> Iterator[tuple[PdoKind, int, int]]:
    """Yield the valid PDOs that the profile does not use and that have the identifier of another frame of the arm.

    A drive with such a PDO could obey another drive's commands. Each is yielded as kind, number and COB-ID.
    """
    pdos_of_arm = (pdo for each in profile.joints for pdo in (*each.commands, *each.answers))
    in_use = _RESERVED | {pdo.cob_id for pdo in pdos_of_arm}
    for kind, pdos in joint.pdos:
        used = {pdo.number for pdo in pdos}
        for number, value in read_records(access, node, kind):
            if number not in used and not value & NOT_VALID and value & IDENTIFIER in in_use:
                yield kind, number, value


def _on_every_sync(access: ObjectAccess, node: int, index: int) -> Iterator[ObjectMismatch]:
    """Yield settings, other than the transmission type, that keep a TPDO from being sent at every SYNC."""
    inhibit = inhibit_s(access, node, index)
    if inhibit >= MAX_INHIBIT_S:
        limit = f"an inhibit time below {1e3 * MAX_INHIBIT_S:g} ms"
        actual = f"{1e3 * inhibit:g} ms"
        yield ObjectMismatch(node, index, INHIBIT, limit, actual, ProfileRemedy.WRITE_PDO)
    if start := read_number(access, node, index, SYNC_START):
        expected = "SYNC start value 0 (with the next SYNC)"
        yield ObjectMismatch(node, index, SYNC_START, expected, f"{start}", ProfileRemedy.WRITE_PDO)


def inhibit_s(access: ObjectAccess, node: int, index: int) -> float:
    """Read the inhibit time of a TPDO, s, from its communication record at `index`."""
    return INHIBIT_S * (read_number(access, node, index, INHIBIT) or 0)


def read_map(access: ObjectAccess, node: int, index: int) -> tuple[Entry, ...] | None:
    """Read a PDO map from the drive; None if the object is absent."""
    count = read_number(access, node, index, 0)
    if count is None:
        return None
    # An answer that states no size may carry anything beyond the count's one byte.
    subs = range(1, min(count & 0xFF, 64) + 1)
    values = (read_number(access, node, index, sub) or 0 for sub in subs)
    return tuple((value >> 16, value >> 8 & 0xFF, value & 0xFF) for value in values)


def _cob_id(
    access: ObjectAccess, node: int, index: int, sub: int, expected: int, *, refused: int
) -> Iterator[ObjectMismatch]:
    value = read_number(access, node, index, sub)
    if value is None or value & (IDENTIFIER | EXTENDED | refused) != expected:
        actual = "no such object" if value is None else f"{value:03X}h"
        if value is not None and value & refused == NOT_VALID:
            actual = f"{value & IDENTIFIER:03X}h switched off ({actual})"
        yield ObjectMismatch(node, index, sub, f"{expected:03X}h", actual)


def read_number(access: ObjectAccess, node: int, index: int, sub: int) -> int | None:
    """Read an unsigned number; None if the object is absent."""
    return read_if_present(access.read_unsigned, node, index, sub)


def read_if_present(
    read: Callable[[int, int, int], Value], node: int, index: int, sub: int = 0
) -> Value | None:
    """Return the value read; None if the refusal shows that the drive lacks the object (`ABSENT`, `_NO_INDEX`)."""
    try:
        return read(node, index, sub)
    except SdoRefused as refusal:
        if refusal.code in ABSENT:
            return None
        try:
            read(node, _NO_INDEX, 0)
        except SdoRefused as of_no_object:
            if of_no_object.code == refusal.code:
                return None
        raise

"""Do a drive's frames carry what we pack and unpack? Read by SDO before anything is enabled. Moves nothing.

Eight bytes are eight bytes: a drive with its velocity where its position belongs answers every SYNC as
it should, and would be told to go to where it never was. So its PDOs are read, and compared as a whole;
then the first position that came by PDO is compared with the one that the object dictionary holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from hardware.errors import MappingDiffers, SdoRefused
from hardware.objects import (
    COB_EMCY,
    COB_SYNC,
    DEVICE_TYPE,
    EMCY_COB_ID,
    POSITION_ACTUAL,
    RPDO1_COMMUNICATION,
    RPDO1_MAP,
    SYNC_COB_ID,
    TPDO1_COMMUNICATION,
    TPDO1_MAP,
    TPDO_EVERY_SYNC,
    Abort,
)
from hardware.profile import BusProfile, Entry, Pdo, map_words
from hardware.scale import JointScale
from hardware.sdo import ObjectAccess

AGREES_RAD = 0.01
"""Position by PDO and by SDO: an RVDT's noise, and what a joint at rest creeps between the two."""

NOT_VALID, _EXTENDED, _GENERATES_SYNC = 1 << 31, 1 << 29, 1 << 30
"""Bits beside an identifier."""
IDENTIFIER = 0x1FFFFFFF
ON_RECEIPT = (254, 255)
"""Not with the next SYNC: STOP must not wait for one."""
EVERY_SYNC = (TPDO_EVERY_SYNC,)
_PREDEFINED = range(1, 5)
"""PDO1 to PDO4 of the predefined connection set: those not in use are allowed, but not on our identifiers."""
_ABSENT = frozenset({Abort.NO_OBJECT, Abort.NO_SUBINDEX})


def check_mapping(access: ObjectAccess, profile: BusProfile, silent: Iterable[int] = ()) -> None:
    """Compare the PDOs of all drives with what this program sends and reads.

    `silent` are nodes that do not answer, and are named with the others. What is no drive at all is not
    looked at.

    Raises
    ------
    MappingDiffers
        Naming node, object, what was expected and what was found, for everything that differs.
    """
    absent = sorted(silent)
    found = [
        text
        for node in profile.drives
        if node not in absent and profile.is_drive(access.read_unsigned(node, DEVICE_TYPE))
        for text in differences(access, node, profile)
    ]
    if found:
        raise MappingDiffers([*found, *(f"{profile.who(node)}: no answer" for node in absent)])


def check_positions(
    access: ObjectAccess,
    profile: BusProfile,
    counts: Sequence[int],
    scales: Sequence[JointScale],
) -> None:
    """Compare positions as TPDO1 brought them with 6064h by SDO; the joints are at rest.

    Raises
    ------
    MappingDiffers
    """
    found = []
    for node, by_pdo, scale in zip(profile.drives, counts, scales, strict=True):
        by_sdo = access.read_signed(node, POSITION_ACTUAL)
        if abs(by_pdo - by_sdo) > AGREES_RAD * scale.density + 1.0:
            found.append(
                f"node {node}, {POSITION_ACTUAL:04X}h: expected the {by_sdo} counts that it holds, "
                f"found {by_pdo} in {_carrier(profile, node)}"
            )
    if found:
        raise MappingDiffers(found)


def differences(access: ObjectAccess, node: int, profile: BusProfile) -> Iterator[str]:
    """What of a drive's PDOs is not as it has to be: node, object, expected and found, in words."""
    yield from _cob_id(access, node, SYNC_COB_ID, 0, COB_SYNC, refused=_GENERATES_SYNC)
    yield from _cob_id(access, node, EMCY_COB_ID, 0, COB_EMCY + node, refused=NOT_VALID)
    joint = profile.joints[profile.joint_of[node] - 1]
    taken = {pdo.cob_id for each in profile.joints for pdo in (*each.commands, *each.answers)} | {
        COB_SYNC
    }
    for letter, communication, mapping, types, pdos in (
        ("R", RPDO1_COMMUNICATION, RPDO1_MAP, ON_RECEIPT, joint.commands),
        ("T", TPDO1_COMMUNICATION, TPDO1_MAP, EVERY_SYNC, joint.answers),
    ):
        for pdo in pdos:
            at = pdo.number - 1
            yield from _cob_id(access, node, communication + at, 1, pdo.cob_id, refused=NOT_VALID)
            yield from _type(access, node, communication + at, types)
            yield from _map(access, node, mapping + at, f"{letter}PDO{pdo.number}", pdo)
        used = {pdo.number for pdo in pdos}
        for number in _PREDEFINED:
            if number in used:
                continue
            value = read_number(access, node, communication + number - 1, 1)
            if value is not None and not value & NOT_VALID and value & IDENTIFIER in taken:
                yield difference_words(
                    node,
                    communication + number - 1,
                    1,
                    "another identifier, or none",
                    f"{value & IDENTIFIER:03X}h, on which this arm's own frames travel",
                )


def read_map(access: ObjectAccess, node: int, index: int) -> tuple[Entry, ...] | None:
    """Map of a PDO as the drive holds it; None where there is no such object."""
    count = read_number(access, node, index, 0)
    if count is None:
        return None
    return tuple(
        _entry(read_number(access, node, index, sub)) for sub in range(1, min(count, 64) + 1)
    )


def _type(access: ObjectAccess, node: int, index: int, types: tuple[int, ...]) -> Iterator[str]:
    kind = read_number(access, node, index, 2)
    if kind not in types:
        expected = " or ".join(map(str, types))
        yield difference_words(node, index, 2, f"transmission type {expected}", _number(kind, "d"))


def _map(access: ObjectAccess, node: int, index: int, name: str, pdo: Pdo) -> Iterator[str]:
    entries = read_map(access, node, index)
    if entries != pdo.entries:
        yield difference_words(
            node,
            index,
            None,
            f"{name} = {map_words(pdo.entries)}",
            "no such object" if entries is None else map_words(entries),
        )


def _carrier(profile: BusProfile, node: int) -> str:
    """Name the TPDO that brings a drive's position."""
    answers = profile.joints[profile.joint_of[node] - 1].answers
    return next(f"TPDO{pdo.number}" for pdo in answers if POSITION_ACTUAL in pdo.carried)


def _cob_id(
    access: ObjectAccess, node: int, index: int, sub: int, expected: int, *, refused: int
) -> Iterator[str]:
    """Compare an identifier; `refused` is the bit that must not be set beside it."""
    value = read_number(access, node, index, sub)
    wrong = value is None or value & (IDENTIFIER | _EXTENDED | refused) != expected
    if wrong:
        yield difference_words(node, index, sub, f"{expected:03X}h", _number(value, "03X"))


def read_number(access: ObjectAccess, node: int, index: int, sub: int) -> int | None:
    """Read a number; None where there is no such object."""
    try:
        return access.read_unsigned(node, index, sub)
    except SdoRefused as refusal:
        if refusal.code in _ABSENT:
            return None
        raise


def _entry(value: int | None) -> Entry:
    value = value or 0
    return value >> 16, value >> 8 & 0xFF, value & 0xFF


def _number(value: int | None, digits: str) -> str:
    if value is None:
        return "no such object"
    return f"{value:{digits}}" + ("h" if digits.endswith("X") else "")


def difference_words(node: int, index: int, sub: int | None, expected: str, found: str) -> str:
    """Say what of an object (all of it, or a sub-index) is not as it has to be."""
    place = f"{index:04X}h" if sub is None else f"{index:04X}h sub {sub}"
    return f"node {node}, {place}: expected {expected}, found {found}"

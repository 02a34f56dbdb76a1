"""Do a drive's frames carry what we pack and unpack? Read by SDO before anything is enabled. Moves nothing.

Eight bytes are eight bytes: a drive with its velocity where its position belongs answers every SYNC as
it should, and would be told to go to where it never was. So its PDOs are read, and compared as a whole;
then the first position that came by PDO is compared with the one that the object dictionary holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from hardware.errors import MappingDiffers, SdoRefused
from hardware.objects import (
    COB_EMCY,
    COB_RPDO1,
    COB_SYNC,
    COB_TPDO1,
    EMCY_COB_ID,
    HEARTBEAT_PRODUCER,
    MAX_JOINTS,
    POSITION_ACTUAL,
    RPDO1_COMMUNICATION,
    RPDO1_MAP,
    RPDO1_MAPPING,
    SYNC_COB_ID,
    TPDO1_COMMUNICATION,
    TPDO1_MAP,
    TPDO1_MAPPING,
    TPDO_EVERY_SYNC,
    Abort,
    joint_node,
)
from hardware.scale import JointScale
from hardware.sdo import ObjectAccess

AGREES_RAD = 0.01
"""Position by PDO and by SDO: an RVDT's noise, and what a joint at rest creeps between the two."""

HEARTBEATS = 2.5
"""Heartbeats of a node that may fail to come before it is called silent."""
SLOWEST_HEARTBEAT_MS = 1000

_NOT_VALID, _EXTENDED, _GENERATES_SYNC = 1 << 31, 1 << 29, 1 << 30
_IDENTIFIER = 0x1FFFFFFF
_ON_RECEIPT = (254, 255)
_OTHER_PDOS = range(1, 4)
"""PDO2 to PDO4 of the predefined connection set: allowed, but not on our identifiers."""
_ABSENT = frozenset({Abort.NO_OBJECT, Abort.NO_SUBINDEX})

Entry = tuple[int, int, int]
"""Index, sub-index, bits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pdo:
    """One PDO as it has to be."""

    name: str
    communication: int
    mapping: int
    cob_id: int
    types: tuple[int, ...]
    entries: tuple[Entry, ...]


def check_mapping(access: ObjectAccess, joints: int) -> None:
    """Compare the PDOs of all drives with what this program sends and reads.

    Raises
    ------
    MappingDiffers
        Naming node, object, what was expected and what was found, for everything that differs.
    """
    found = [
        text
        for joint in range(1, joints + 1)
        for text in differences(access, joint_node(joint), joints)
    ]
    if found:
        raise MappingDiffers(found)


def check_positions(
    access: ObjectAccess, counts: Sequence[int], scales: Sequence[JointScale]
) -> None:
    """Compare positions as TPDO1 brought them with 6064h by SDO; the joints are at rest.

    Raises
    ------
    MappingDiffers
    """
    found = []
    for joint, (by_pdo, scale) in enumerate(zip(counts, scales, strict=True), 1):
        node = joint_node(joint)
        by_sdo = access.read_signed(node, POSITION_ACTUAL)
        if abs(by_pdo - by_sdo) > AGREES_RAD * scale.counts_per_rad + 1.0:
            found.append(
                f"node {node}, {POSITION_ACTUAL:04X}h: expected the {by_sdo} counts that it holds, "
                f"found {by_pdo} in TPDO1"
            )
    if found:
        raise MappingDiffers(found)


def patience_s(access: ObjectAccess, nodes: Iterable[int], least_s: float) -> float:
    """How long a silence may be: as asked for, and some heartbeats (1017h) of the slowest node.

    Raises
    ------
    MappingDiffers
        A node sends none, or so seldom that its loss would go unnoticed.
    """
    found, longest_s = [], 0.0
    for node in nodes:
        period_ms = _read(access, node, HEARTBEAT_PRODUCER, 0)
        if period_ms is None:  # that it is heard is made sure of
            continue
        longest_s = max(longest_s, 1e-3 * period_ms)
        if not 0 < period_ms <= SLOWEST_HEARTBEAT_MS:
            expected = f"a heartbeat every 1 .. {SLOWEST_HEARTBEAT_MS} ms"
            found.append(_words(node, HEARTBEAT_PRODUCER, 0, expected, f"{period_ms} ms"))
    if found:
        raise MappingDiffers(found)
    return max(least_s, HEARTBEATS * longest_s)


def differences(access: ObjectAccess, node: int, joints: int = MAX_JOINTS) -> Iterator[str]:
    """What of a drive's PDOs is not as it has to be: node, object, expected and found, in words."""
    yield from _cob_id(access, node, SYNC_COB_ID, 0, COB_SYNC, refused=_GENERATES_SYNC)
    yield from _cob_id(access, node, EMCY_COB_ID, 0, COB_EMCY + node, refused=_NOT_VALID)
    for pdo in (
        _Pdo(
            name="RPDO1",
            communication=RPDO1_COMMUNICATION,
            mapping=RPDO1_MAP,
            cob_id=COB_RPDO1 + node,
            types=_ON_RECEIPT,
            entries=RPDO1_MAPPING,
        ),
        _Pdo(
            name="TPDO1",
            communication=TPDO1_COMMUNICATION,
            mapping=TPDO1_MAP,
            cob_id=COB_TPDO1 + node,
            types=(TPDO_EVERY_SYNC,),
            entries=TPDO1_MAPPING,
        ),
    ):
        yield from _pdo_differences(access, node, pdo)
    taken = {
        cob + joint_node(j) for cob in (COB_RPDO1, COB_TPDO1) for j in range(1, joints + 1)
    } | {COB_SYNC}
    for first in (RPDO1_COMMUNICATION, TPDO1_COMMUNICATION):
        for further in _OTHER_PDOS:
            value = _read(access, node, first + further, 1)
            if value is not None and not value & _NOT_VALID and value & _IDENTIFIER in taken:
                yield _words(
                    node,
                    first + further,
                    1,
                    "another identifier, or none",
                    f"{value & _IDENTIFIER:03X}h, on which this arm's own frames travel",
                )


def _pdo_differences(access: ObjectAccess, node: int, pdo: _Pdo) -> Iterator[str]:
    yield from _cob_id(access, node, pdo.communication, 1, pdo.cob_id, refused=_NOT_VALID)
    kind = _read(access, node, pdo.communication, 2)
    if kind not in pdo.types:
        expected = " or ".join(map(str, pdo.types))
        yield _words(
            node, pdo.communication, 2, f"transmission type {expected}", _number(kind, "d")
        )
    count = _read(access, node, pdo.mapping, 0)
    entries = [
        _entry(_read(access, node, pdo.mapping, sub)) for sub in range(1, min(count or 0, 64) + 1)
    ]
    if tuple(entries) != pdo.entries:
        yield _words(
            node,
            pdo.mapping,
            None,
            f"{pdo.name} = {_map_words(pdo.entries)}",
            "no such object" if count is None else _map_words(entries),
        )


def _cob_id(
    access: ObjectAccess, node: int, index: int, sub: int, expected: int, *, refused: int
) -> Iterator[str]:
    """Compare an identifier; `refused` is the bit that must not be set beside it."""
    value = _read(access, node, index, sub)
    wrong = value is None or value & (_IDENTIFIER | _EXTENDED | refused) != expected
    if wrong:
        yield _words(node, index, sub, f"{expected:03X}h", _number(value, "03X"))


def _read(access: ObjectAccess, node: int, index: int, sub: int) -> int | None:
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


def _map_words(entries: Iterable[Entry]) -> str:
    words = [f"{index:04X}h{f' sub {sub}' if sub else ''}({bits})" for index, sub, bits in entries]
    return " + ".join(words) or "nothing"


def _number(value: int | None, digits: str) -> str:
    if value is None:
        return "no such object"
    return f"{value:{digits}}" + ("h" if digits.endswith("X") else "")


def _words(node: int, index: int, sub: int | None, expected: str, found: str) -> str:
    place = f"{index:04X}h" if sub is None else f"{index:04X}h sub {sub}"
    return f"node {node}, {place}: expected {expected}, found {found}"

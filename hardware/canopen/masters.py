"""Recognises the frames that only a CANopen master sends, by identifier and first bytes."""

from __future__ import annotations

from typing import Final

from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.objects import (
    COB_HEARTBEAT,
    COB_NEXT_PDO,
    COB_NMT,
    COB_RPDO1,
    COB_SDO_TO_SERVER,
    COB_SYNC,
    OPERATOR_NODE,
    NmtCommand,
)

_RPDOS: Final = tuple(COB_RPDO1 + at * COB_NEXT_PDO for at in range(4))
"""Base identifiers of RPDO1..4 in CiA 301's predefined connection set."""
_WRITES: Final = {1: True, 2: False, 5: False, 6: True}
"""Whether an SDO client command specifier (download, upload, block upload, block download) writes."""
_CONTINUED_BLOCK: Final = {5: 0x03, 6: 0x01}
"""Subcommand bits of a block transfer that is already running."""


def describe_master_frame(profile: BusProfile, identifier: int, data: bytes) -> str:
    """Describe a frame that only a master sends, with its identifier; empty for frames of the nodes.

    TPDOs of the profile count as frames of the nodes, whatever their identifiers.
    """
    cob_id = f"({identifier:03X}h)"
    if identifier == COB_NMT:
        return f"{_describe_nmt(data)} {cob_id}"
    if identifier == COB_SYNC:
        return f"SYNC {cob_id}"
    if identifier == COB_HEARTBEAT + OPERATOR_NODE:
        return f"the heartbeat of an operator, node {OPERATOR_NODE} {cob_id}"
    if COB_SDO_TO_SERVER < identifier <= COB_SDO_TO_SERVER + OPERATOR_NODE:
        return f"{_describe_sdo(data)} node {identifier - COB_SDO_TO_SERVER} {cob_id}"
    for joint, drive in enumerate(profile.joints, 1):
        if any(pdo.cob_id == identifier for pdo in drive.answers):
            return ""
        if any(pdo.cob_id == identifier for pdo in drive.commands):
            return f"a command to joint {joint} {cob_id}"
    for number, base in enumerate(_RPDOS, 1):
        if base < identifier <= base + OPERATOR_NODE:
            return f"a command to node {identifier - base}, RPDO{number} {cob_id}"
    return ""


def _describe_nmt(data: bytes) -> str:
    if len(data) != 2:
        return "an NMT command"
    known = {command.value: command.name.lower().replace("_", " ") for command in NmtCommand}
    target = f"node {data[1]}" if data[1] else "all nodes"
    return f"NMT, {known.get(data[0], f'command {data[0]}')} to {target}"


def initiated_transfer(data: bytes) -> tuple[bool, int] | None:
    """Whether an SDO request initiates a write, and the index; None if it initiates no transfer."""
    kind = data[0] >> 5 if len(data) == 8 else None
    if kind not in _WRITES or data[0] & _CONTINUED_BLOCK.get(kind, 0):
        return None
    return _WRITES[kind], int.from_bytes(data[1:3], "little")


def _describe_sdo(data: bytes) -> str:
    begun = initiated_transfer(data)
    if begun is None:
        return "an SDO transfer with"
    writes, index = begun
    return f"{'a write to' if writes else 'a read of'} {index:04X}h of"

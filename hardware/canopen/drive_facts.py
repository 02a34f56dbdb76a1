"""What drives say of how they would stop, hold and watch over the operator, read by SDO. Changes nothing."""

from __future__ import annotations

from dataclasses import dataclass

from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.maps import read_number
from hardware.canopen.objects import (
    HEARTBEAT_CONSUMER,
    OPERATOR_NODE,
    QUICK_STOP_OPTION,
    SUPPORTED_MODES,
)
from hardware.canopen.sdo import ObjectAccess


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveFacts:
    """One joint's drive; None where it does not say.

    Attributes
    ----------
    lacking_modes
        Codes (6060h) of modes that the profile wants and 6502h has not.
    quick_stop_option
        605Ah: from 5 on, the drive holds after a quick stop.
    misses_operator_after_s
        1016h: silence of node 127 after which the drive stops by itself.
    """

    joint: int
    lacking_modes: tuple[int, ...] | None
    quick_stop_option: int | None
    misses_operator_after_s: float | None


def read_drive_facts(access: ObjectAccess, profile: BusProfile) -> tuple[DriveFacts, ...]:
    """Ask every drive."""
    return tuple(
        DriveFacts(
            joint=joint,
            lacking_modes=_lacking(access, node, profile),
            quick_stop_option=read_number(access, node, QUICK_STOP_OPTION, 0),
            misses_operator_after_s=misses_operator_after_s(access, node),
        )
        for joint, node in enumerate(profile.drives, 1)
    )


def _lacking(access: ObjectAccess, node: int, profile: BusProfile) -> tuple[int, ...] | None:
    supported = read_number(access, node, SUPPORTED_MODES, 0)
    if supported is None:
        return None
    # Modes of the maker's own have codes below 0, and no bit.
    return tuple(
        code
        for code in sorted(profile.mode_codes.values())
        if code > 0 and not supported >> (code - 1) & 1
    )


def misses_operator_after_s(access: ObjectAccess, node: int) -> float | None:
    """Silence of node 127 after which a drive stops by itself (1016h); None where it does not say."""
    for sub in range(1, (read_number(access, node, HEARTBEAT_CONSUMER, 0) or 0) + 1):
        entry = read_number(access, node, HEARTBEAT_CONSUMER, sub) or 0
        if entry >> 16 & 0x7F == OPERATOR_NODE and entry & 0xFFFF:
            return (entry & 0xFFFF) * 1e-3
    return None

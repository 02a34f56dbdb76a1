"""Reads the set-up of a drive by SDO: its PDOs, heartbeats, windows, quick stop, and descriptive objects."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from hardware.arm_description import JointScale
from hardware.canopen import bus_profile, objects
from hardware.canopen.bus_profile import RPDO, TPDO, BusProfile, Entry, PdoKind
from hardware.canopen.maps import IDENTIFIER, NOT_VALID, read_map, read_number, read_records
from hardware.errors import MappingMismatch, ObjectMismatch, ProfileRemedy, SdoRefused

if TYPE_CHECKING:
    from hardware.canopen.sdo import ObjectAccess

DESCRIPTION_OBJECTS: Final = (
    objects.POSITION_LIMITS,
    objects.ENCODER_RESOLUTION,
    objects.CONTROL_PERIOD,
    objects.SENSOR,
)
"""Objects that can be compared with an arm file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivePdo:
    """A PDO of a drive: a TPDO if `sent`, otherwise an RPDO. `transmission` and `entries` are read only if `valid`."""

    sent: bool
    number: int
    valid: bool
    cob_id: int
    transmission: int
    entries: tuple[Entry, ...]

    @property
    def kind(self) -> PdoKind:
        """Kind of the PDO."""
        return TPDO if self.sent else RPDO


def read_pdos(access: ObjectAccess, node: int) -> Iterator[DrivePdo]:
    """Read the PDOs of a drive, RPDOs first."""
    for kind in (RPDO, TPDO):
        for number, cob_id in read_records(access, node, kind):
            communication, mapping = kind.records(number)
            valid = not cob_id & NOT_VALID
            transmission = read_number(access, node, communication, 2) if valid else None
            yield DrivePdo(
                sent=kind is TPDO,
                number=number,
                valid=valid,
                cob_id=cob_id & IDENTIFIER,
                transmission=255 if transmission is None else transmission,
                entries=(read_map(access, node, mapping) or ()) if valid else (),
            )


HEARTBEAT_TIMEOUT_PERIODS = 2.5
"""Heartbeat periods without a heartbeat after which a node counts as silent."""
FOLLOWING_FRACTION, FOLLOWING_RAD = 1 / 3, math.radians(1.0)
"""A joint's distance from its target is limited to FOLLOWING_FRACTION of the drive's following error window (6065h),
and to at most FOLLOWING_RAD. In moves without fault the virtual arms' joints are at most 0.11 deg from their targets;
their drives trip at 3 deg."""
NO_FOLLOWING_WINDOW = 0xFFFF_FFFF
"""Value of 6065h with which a drive does not check its following error (CiA 402-2)."""
MIN_WINDOW_COUNTS = 10.0
"""Smallest limit of the distance from the target: below it, sensor noise would count as an error."""


def operator_timeout_s(access: ObjectAccess, node: int) -> float | None:
    """Read a drive's time-out (1016h) for the operator's heartbeat, s; None if this heartbeat is not monitored."""
    timeouts_ms = map(_operator_timeout_ms, _heartbeat_consumers(access, node) or ())
    return next((1e-3 * timeout_ms for timeout_ms in timeouts_ms if timeout_ms), None)


def ignores_operator_timeout(access: ObjectAccess, node: int) -> bool:
    """Whether the drive states that it takes no action after a heartbeat time-out (6007h = 0)."""
    try:
        return access.read_unsigned(node, objects.ABORT_OPTION) == 0
    except SdoRefused:  # an optional object
        return False


def _operator_timeout_ms(entry: int) -> int:
    """Return the time-out in an entry of 1016h, ms; 0 if the entry is not for the operator's heartbeat."""
    return entry & 0xFFFF if entry >> 16 & 0x7F == objects.OPERATOR_NODE else 0


def _heartbeat_consumers(access: ObjectAccess, node: int) -> tuple[int, ...] | None:
    count = read_number(access, node, objects.HEARTBEAT_CONSUMER, 0)
    if count is None:
        return None
    index, subs = objects.HEARTBEAT_CONSUMER, range(1, (count & 0xFF) + 1)
    return tuple(read_number(access, node, index, sub) or 0 for sub in subs)


def heartbeat_timeout_s(access: ObjectAccess, profile: BusProfile, min_s: float) -> float:
    """Return the time without a heartbeat, s, after which a node counts as lost.

    The time is 2.5 heartbeat periods (1017h) of the slowest node, but at least `min_s`. Raises `MappingMismatch` for
    nodes that send no heartbeat or whose period is too long.
    """
    mismatches, longest_s = [], 0.0
    for node in profile.nodes:
        period_ms = read_number(access, node, objects.HEARTBEAT_PRODUCER, 0)
        if period_ms is None:  # its heartbeat is waited for in any case
            continue
        longest_s = max(longest_s, 1e-3 * period_ms)
        if not 0 < period_ms <= profile.slowest_heartbeat_ms:
            allowable = 0 < period_ms <= bus_profile.MAX_HEARTBEAT_MS
            remedy = ProfileRemedy.HEARTBEAT_PERIOD if allowable else ProfileRemedy.NONE
            expected = f"a heartbeat every 1 .. {profile.slowest_heartbeat_ms} ms"
            place = node, objects.HEARTBEAT_PRODUCER, 0
            mismatches.append(ObjectMismatch(*place, expected, f"{period_ms} ms", remedy))
    if mismatches:
        raise MappingMismatch(mismatches)
    return max(min_s, HEARTBEAT_TIMEOUT_PERIODS * longest_s)


def check_operator_monitoring(access: ObjectAccess, profile: BusProfile) -> tuple[int, ...]:
    """Check that drives monitor the operator's heartbeat (1016h).

    Returns the joints whose drives have no 1016h, or take no action after the time-out (6007h = 0). Raises
    `MappingMismatch` for drives whose 1016h has no time-out for that heartbeat, or a time-out above the limit.
    """
    differences = {node: operator_monitoring_differences(access, node) for node in profile.drives}
    if wrong := [text for texts in differences.values() for text in texts or ()]:
        raise MappingMismatch(wrong)
    return tuple(
        profile.joint_of[node]
        for node, texts in differences.items()
        if texts is None or ignores_operator_timeout(access, node)
    )


def operator_monitoring_differences(
    access: ObjectAccess, node: int
) -> tuple[ObjectMismatch, ...] | None:
    """Return why a drive does not monitor the operator's heartbeat; empty if it does, None if there is no 1016h."""
    watched = _heartbeat_consumers(access, node)
    if watched is None:
        return None
    limit_ms, operator = 1e3 * objects.MAX_OPERATOR_TIMEOUT_S, objects.OPERATOR_NODE
    if any(0 < timeout_ms <= limit_ms for timeout_ms in map(_operator_timeout_ms, watched)):
        return ()
    entries = ", ".join(f"{value:08X}h" for value in watched) or "no entry"
    expected = f"a time-out of at most {limit_ms:.0f} ms for the heartbeat of node {operator}"
    place = node, objects.HEARTBEAT_CONSUMER, None
    return (ObjectMismatch(*place, expected, entries, ProfileRemedy.NONE),)


def following_windows_counts(
    access: ObjectAccess, profile: BusProfile, scales: Sequence[JointScale]
) -> tuple[float, ...]:
    """Return each joint's allowed following error, counts: a third of 6065h, at most 1 deg, but at least 10 counts."""
    windows = []
    for node, scale in zip(profile.drives, scales, strict=True):
        drive_window = read_number(access, node, objects.FOLLOWING_WINDOW, 0)
        upper = FOLLOWING_RAD * scale.density
        window = FOLLOWING_FRACTION * drive_window if drive_window else upper
        windows.append(max(min(window, upper), MIN_WINDOW_COUNTS))
    return tuple(windows)

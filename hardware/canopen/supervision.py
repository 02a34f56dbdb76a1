"""Who watches whom: heartbeats and windows that the nodes are set up with, by SDO. Moves nothing, changes nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hardware.canopen.bus_profile import LONGEST_HEARTBEAT_MS, BusProfile
from hardware.canopen.maps import read_number
from hardware.canopen.objects import (
    FOLLOWING_WINDOW,
    HEARTBEAT_CONSUMER,
    HEARTBEAT_PRODUCER,
    LONGEST_WATCH_S,
    OPERATOR_NODE,
)
from hardware.canopen.sdo import ObjectAccess
from hardware.errors import InProfile, MappingDiffers, ObjectMismatch
from hardware.scale import JointScale

HEARTBEATS = 2.5
"""Heartbeats of a node that may fail to come before it is called silent."""

FOLLOWING_SHARE, FOLLOWING_RAD = 1 / 3, math.radians(1.0)
"""On ways without a fault the virtual arms' joints are at most 0.11 deg from their targets; a drive trips at 3 deg."""
FEWEST_COUNTS = 10.0
"""No window is smaller: what a drive that trips sooner calls an error may be its sensor's noise."""


def patience_s(access: ObjectAccess, profile: BusProfile, least_s: float) -> float:
    """How long a silence may be: as asked for, and some heartbeats (1017h) of the slowest node.

    Raises
    ------
    MappingDiffers
        A node sends none, or so seldom that its loss would go unnoticed.
    """
    found, longest_s = [], 0.0
    for node in profile.nodes:
        period_ms = read_number(access, node, HEARTBEAT_PRODUCER, 0)
        if period_ms is None:  # that it is heard is made sure of
            continue
        longest_s = max(longest_s, 1e-3 * period_ms)
        if not 0 < period_ms <= profile.slowest_heartbeat_ms:
            sayable = 0 < period_ms <= LONGEST_HEARTBEAT_MS
            found.append(
                ObjectMismatch(
                    node=node,
                    index=HEARTBEAT_PRODUCER,
                    sub=0,
                    expected=f"a heartbeat every 1 .. {profile.slowest_heartbeat_ms} ms",
                    found=f"{period_ms} ms",
                    in_profile=InProfile.AS_PATIENCE if sayable else InProfile.NOT,
                )
            )
    if found:
        raise MappingDiffers(found)
    return max(least_s, HEARTBEATS * longest_s)


def check_watch(access: ObjectAccess, profile: BusProfile) -> tuple[int, ...]:
    """Make sure that drives watch the operator's heartbeat (1016h).

    Returns
    -------
    Joints whose drives have no such object: nobody knows what they do without an operator.

    Raises
    ------
    MappingDiffers
        A drive would go on when the operator is gone.
    """
    found = {node: watch_differences(access, node) for node in profile.drives}
    wrong = [text for texts in found.values() for text in texts or ()]
    if wrong:
        raise MappingDiffers(wrong)
    return tuple(profile.joint_of[node] for node, texts in found.items() if texts is None)


def watch_differences(access: ObjectAccess, node: int) -> tuple[ObjectMismatch, ...] | None:
    """What of a drive's watch over the operator's heartbeat is not as it has to be; None without 1016h."""
    entries = read_number(access, node, HEARTBEAT_CONSUMER, 0)
    if entries is None:
        return None
    watched = [
        read_number(access, node, HEARTBEAT_CONSUMER, sub) or 0 for sub in range(1, entries + 1)
    ]
    if any(
        value >> 16 & 0x7F == OPERATOR_NODE and 0 < value & 0xFFFF <= 1e3 * LONGEST_WATCH_S
        for value in watched
    ):
        return ()
    seen = ", ".join(f"{value:08X}h" for value in watched) or "no entry"
    expected = (
        f"node {OPERATOR_NODE}'s heartbeat watched, for {1e3 * LONGEST_WATCH_S:.0f} ms at the most"
    )
    return (
        ObjectMismatch(
            node=node,
            index=HEARTBEAT_CONSUMER,
            expected=expected,
            found=seen,
            in_profile=InProfile.NOT,
        ),
    )


def following_windows_counts(
    access: ObjectAccess, profile: BusProfile, scales: Sequence[JointScale]
) -> tuple[float, ...]:
    """How far from its target a joint may be before the operator is told: part of what its drive takes (6065h).

    Never more than `FOLLOWING_RAD`: a drive may take anything, or not say what.
    """
    windows = []
    for node, scale in zip(profile.drives, scales, strict=True):
        told = read_number(access, node, FOLLOWING_WINDOW, 0)
        usual = FOLLOWING_RAD * scale.density
        share = FOLLOWING_SHARE * told if told else usual
        windows.append(max(min(share, usual), FEWEST_COUNTS))
    return tuple(windows)

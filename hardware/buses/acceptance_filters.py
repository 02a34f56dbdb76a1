"""Which frames each end of an arm's bus takes in, as acceptance filters. Knows identifiers; no bus and no frame.

A bus that others fill costs whoever receives it the time to look at every frame. Adapters, kernels and the
loopback bus keep out what a filter does not name, before anybody is woken for it. Where none of them can, every
frame is taken in, and its receiver passes over what it does not know.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator

import can
from can.interfaces.virtual import VirtualBus
from can.typechecking import CanFilter

from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.objects import (
    COB_EMCY,
    COB_HEARTBEAT,
    COB_NMT,
    COB_RPDO1,
    COB_SDO_FROM_SERVER,
    COB_SDO_TO_SERVER,
    COB_SYNC,
    SUPERVISOR_NODE,
)

_ALL_BITS = 0x7FF
_FUNCTION_CODE = 0x780


def set_hardware_filters(bus: can.BusABC, filters: list[CanFilter]) -> None:
    """Have a bus keep out what no filter names, if it can do so before this process is asked.

    python-can's own filter will not do: a `recv` that is not to wait says of a frame which it throws away that
    there was none, and whoever empties a queue stops there, with answers behind it. On the bus inside this
    process nobody else is, and what is kept out need not be looked at.

    Adapters that have room for fewer filters (Kvaser, SYSTEC and Vector for one) leave all of it to python-can,
    and say so in `_is_filtered`: they are left without.
    """
    if isinstance(bus, VirtualBus):
        bus.set_filters(filters)
        return
    nothing = can.BusABC._apply_filters  # noqa: SLF001 - the hook for adapters that can
    if getattr(type(bus), "_apply_filters", nothing) is nothing:
        return
    bus.set_filters(filters)
    if not getattr(bus, "_is_filtered", True):  # those without the flag, as ETAS's, have room
        bus.set_filters(None)


def operator_filters(profile: BusProfile) -> list[CanFilter]:
    """What the operator's end looks at: what the arm says, and what others might command it."""
    return [
        _covering(pdo.cob_id for joint in profile.joints for pdo in joint.answers),
        _one(COB_SYNC),  # nobody else's business
        _one(COB_NMT),
        _covering(pdo.cob_id for joint in profile.joints for pdo in joint.commands),
        *(
            found
            for base in (COB_SDO_FROM_SERVER, COB_SDO_TO_SERVER, COB_EMCY)
            for found in _nodes_of(profile, base)
        ),
        _filter(COB_HEARTBEAT, _FUNCTION_CODE),  # of whoever may hold the token
    ]


def controller_filters(joints: int) -> list[CanFilter]:
    """What the arm's end looks at: what it may be told, and the heartbeat of whoever may hold the token."""
    return [
        _one(COB_SYNC),
        _joints(COB_RPDO1, joints),
        *_nodes(COB_SDO_TO_SERVER, joints),
        _one(COB_NMT),
        _filter(COB_HEARTBEAT, _FUNCTION_CODE),
    ]


def _nodes_of(profile: BusProfile, base: int) -> Iterator[CanFilter]:
    yield _covering(base + node for node in profile.drives)
    if profile.supervisor is not None:
        yield _one(base + profile.supervisor)


def _covering(identifiers: Iterable[int]) -> CanFilter:
    """One filter for all of these, and for what lies between them: a filter is a mask."""
    first, *others = identifiers
    differing = functools.reduce(lambda bits, other: bits | (first ^ other), others, 0)
    mask = _ALL_BITS & ~((1 << differing.bit_length()) - 1)
    return _filter(first & mask, mask)


def _nodes(base: int, joints: int) -> tuple[CanFilter, CanFilter]:
    return _joints(base, joints), _one(base + SUPERVISOR_NODE)


def _joints(base: int, joints: int) -> CanFilter:
    """Nodes 0 to `joints`, and up to the next power of two: a filter is a mask."""
    return _filter(base, _ALL_BITS & ~((1 << joints.bit_length()) - 1))


def _one(identifier: int) -> CanFilter:
    return _filter(identifier, _ALL_BITS)


def _filter(identifier: int, mask: int) -> CanFilter:
    return {"can_id": identifier, "can_mask": mask, "extended": False}

"""Acceptance filters of the operator and of the arm's nodes.

Adapters, kernels and the loopback bus drop frames that no filter passes, so that such frames wake no process. If
none of these can filter, every frame is received, and unknown frames are ignored.
"""

import functools
from collections.abc import Iterable

import can
from can.typechecking import CanFilter

from hardware.canopen import objects
from hardware.canopen.bus_profile import BusProfile

_ALL_BITS = 0x7FF
_FUNCTION_CODE = 0x780


def set_hardware_filters(bus: can.BusABC, filters: list[CanFilter]) -> None:
    """Set filters on a bus whose adapter or kernel filters; other buses get no filters.

    On other buses python-can would filter in software. There, `recv` without waiting returns None for a dropped frame,
    and a reader that stops at None would miss the answers behind that frame. An adapter with room for one filter only
    (Kvaser, SYSTEC, Vector) also leaves the filtering to python-can, and sets `_is_filtered` to false. This function
    then removes the filters again.
    """
    nothing = can.BusABC._apply_filters  # noqa: SLF001 - overridden by adapters with filters
    if getattr(type(bus), "_apply_filters", nothing) is nothing:
        return
    bus.set_filters(filters)
    if not getattr(bus, "_is_filtered", True):  # adapters without this flag have room for all
        bus.set_filters(None)


def operator_filters(profile: BusProfile) -> list[CanFilter]:
    """Return the operator's filters, which accept frames of the arm and commands of other masters."""
    return [
        _covering(pdo.cob_id for joint in profile.joints for pdo in joint.answers),
        _covering([objects.COB_SYNC]),
        _covering([objects.COB_NMT]),
        _covering(pdo.cob_id for joint in profile.joints for pdo in joint.commands),
        *(
            _covering(base + node for node in nodes)
            for base in (objects.COB_SDO_FROM_SERVER, objects.COB_SDO_TO_SERVER, objects.COB_EMCY)
            for nodes in (profile.drives, profile.nodes[len(profile.drives) :])
            if nodes
        ),
        _filter(objects.COB_HEARTBEAT, _FUNCTION_CODE),  # of every node that may hold the token
    ]


def controller_filters(joints: int) -> list[CanFilter]:
    """Return the filters of a simulated arm's nodes; they pass commands to these nodes and every heartbeat."""
    return [
        _covering([objects.COB_SYNC]),
        *(
            _covering(range(base, base + joints + 1))
            for base in (objects.COB_RPDO1, objects.COB_SDO_TO_SERVER)
        ),
        _covering([objects.COB_SDO_TO_SERVER + objects.SUPERVISOR_NODE]),
        _covering([objects.COB_NMT]),
        _filter(objects.COB_HEARTBEAT, _FUNCTION_CODE),
    ]


def _covering(identifiers: Iterable[int]) -> CanFilter:
    """Return one filter that passes all `identifiers` and possibly some others."""
    first, *others = identifiers
    differing = functools.reduce(lambda bits, other: bits | (first ^ other), others, 0)
    mask = _ALL_BITS & ~((1 << differing.bit_length()) - 1)
    return _filter(first & mask, mask)


def _filter(identifier: int, mask: int) -> CanFilter:
    return {"can_id": identifier, "can_mask": mask, "extended": False}

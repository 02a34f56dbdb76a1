"""Checks by SDO whether another operator is using the arm, before its nodes are reset.

An operator may be silent as long as the drives' time-out for its heartbeat (1016h); a communication reset would
then hit a moving arm. So if drives are enabled or the control token is held, this program listens for that
time-out: a live operator is heard, and without one the drives stop. Otherwise there is no wait.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from math import ceil
from typing import Final

from hardware.arm import DriveState
from hardware.canopen.cia402 import POWERED_STATES, state_of
from hardware.canopen.objects import STATUSWORD, TOKEN
from hardware.canopen.sdo import ObjectAccess
from hardware.canopen.supervision import operator_timeout_s
from hardware.errors import ArmInUse, BusError, ControlDenied, HardwareError
from hardware.monitors.node_monitor import NodeMonitor

DEFAULT_TIMEOUT_S: Final = 1.0
"""For nodes that do not state their time-out."""
MARGIN: Final = 1.5
"""Factor on a stated time-out, for reaction time and late answers."""
POLL_S: Final = 0.1

_Object = tuple[int, int]
"""Node and index."""


def require_unused(
    access: ObjectAccess, nodes: NodeMonitor, listen: Callable[[float], None], *, takes_over: bool
) -> None:
    """Return if no other operator can be using the arm.

    Parameters
    ----------
    access, nodes
        Object access and state of the arm's nodes; nodes without answers are ignored.
    listen
        Listens for a number of seconds and raises for any operator heard.
    takes_over
        Whether drives that stay enabled in silence may be taken over.

    Raises
    ------
    ControlDenied
        The holder of the token is heard.
    ArmInUse
        A drive stays enabled beyond its time-out, or stays stopped with the token held. A stopped drive with a
        free token belongs to no operator, and connecting enables nothing.
    """
    profile = nodes.profile
    statuswords = [(node, STATUSWORD) for node in profile.drives]
    tokens = [] if profile.supervisor is None else [(profile.supervisor, TOKEN)]
    values = _read_all(access, (*statuswords, *tokens))
    if values:  # again where a frame may have been lost
        values |= _read_all(access, [key for key in (*statuswords, *tokens) if key not in values])
    enabled, holder = _powered(values), _token_holder(values)
    if not enabled and not holder:
        return
    timeout_s = _timeout_s(access, [*enabled, *(node for node, _ in tokens if holder)])
    for _ in range(ceil(timeout_s / POLL_S)):
        listen(POLL_S)
        if holder in nodes.foreign_nodes:
            raise ControlDenied(holder)
        # A node without an answer keeps its last value.
        values |= _read_all(access, [*((node, STATUSWORD) for node in enabled), *tokens])
        enabled, holder = _powered(values), _token_holder(values)
        if not enabled and not holder:
            return
    obeys = DriveState.OPERATION_ENABLED in enabled.values()
    if not takes_over and (obeys or (enabled and holder)):
        named = [f"{profile.who(node)} is in {state.value}" for node, state in enabled.items()]
        raise ArmInUse(named, timeout_s)


def _powered(values: Mapping[_Object, int]) -> dict[int, DriveState]:
    """Drives that close a loop, with their state."""
    states = {node: state_of(word) for (node, index), word in values.items() if index == STATUSWORD}
    return {node: state for node, state in states.items() if state in POWERED_STATES}


def _token_holder(values: Mapping[_Object, int]) -> int:
    """Node in control; 0 if none."""
    return next((holder for (_, index), holder in values.items() if index == TOKEN), 0)


def _read_all(access: ObjectAccess, objects: Sequence[_Object]) -> dict[_Object, int]:
    """Values of the objects that are answered, read in parallel: each absent node costs a time-out."""

    def read(key: _Object) -> int | None:
        try:
            return int.from_bytes(access.read_once(*key), "little")
        except HardwareError:
            return None

    with ThreadPoolExecutor(max(len(objects), 1)) as pool:
        answers = zip(objects, pool.map(read, objects), strict=True)
        return {key: value for key, value in answers if value is not None}


def _timeout_s(access: ObjectAccess, nodes: Iterable[int]) -> float:
    """Longest silence of an operator that these drives, or this supervisor, accept."""
    timeout_s = DEFAULT_TIMEOUT_S
    for node in nodes:
        try:
            timeout_s = max(timeout_s, MARGIN * (operator_timeout_s(access, node) or 0.0))
        except BusError:
            continue
    return timeout_s

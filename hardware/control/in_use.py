"""Is somebody at work on this arm who is not heard just now? Asked by SDO before its nodes are reset.

An operator may be late, as this program may be: its drives put up with that for as long as they are told to
(1016h). A reset of their communication meanwhile would strike an arm that moves. So an arm whose drives are
enabled, or whose control token somebody holds, is listened to for as long as drives and supervisor would wait
themselves: whoever is alive is heard by then, and without him they have let go. Where nothing is found, nobody waits.
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

LEAST_S: Final = 1.0
"""Of nodes that do not say how long they wait."""
MARGIN: Final = 1.5
"""On what they say, for their reaction and for answers that come late."""
LOOK_AGAIN_S: Final = 0.1

_Place = tuple[int, int]
"""A node, and the index of an object there."""


def require_unused(
    access: ObjectAccess, nodes: NodeMonitor, listen: Callable[[float], None], *, takes_over: bool
) -> None:
    """Go on if nobody can be at work on this arm; one who is heard meanwhile is `listen`'s affair.

    Parameters
    ----------
    access
        To the arm's nodes; those that do not answer are not judged here.
    nodes
        Which they are, and who else is heard.
    listen
        Listens for so many seconds, and raises for whoever is heard.
    takes_over
        Whether drives that stay enabled though nobody was heard are taken for left behind.

    Raises
    ------
    ControlDenied
        Whoever holds the token is heard.
    ArmInUse
        A drive obeys commands for longer than it would wait for an operator; or it was stopped, and the token is
        held for as long. One that was stopped is nobody's when the token is free: whoever stopped it has gone,
        and to connect enables nothing.
    """
    profile = nodes.profile
    asked = [(node, STATUSWORD) for node in profile.drives]
    tokens = [] if profile.supervisor is None else [(profile.supervisor, TOKEN)]
    said = _asked(access, (*asked, *tokens))
    if said:  # one frame that was lost is no drive that is off
        said |= _asked(access, [place for place in (*asked, *tokens) if place not in said])
    enabled, held = _enabled(said), _holder(said)
    if not enabled and not held:
        return
    patience_s = _patience_s(access, [*enabled, *(node for node, _ in tokens if held)])
    for _ in range(ceil(patience_s / LOOK_AGAIN_S)):
        listen(LOOK_AGAIN_S)
        if held in nodes.foreign_nodes:
            raise ControlDenied(held)
        # Who does not answer now is what he said last.
        said |= _asked(access, [*((node, STATUSWORD) for node in enabled), *tokens])
        enabled, held = _enabled(said), _holder(said)
        if not enabled and not held:
            return
    obeys = DriveState.OPERATION_ENABLED in enabled.values()
    if not takes_over and (obeys or (enabled and held)):
        named = [f"{profile.who(node)} is in {state.value}" for node, state in enabled.items()]
        raise ArmInUse(named, patience_s)


def _enabled(said: Mapping[_Place, int]) -> dict[int, DriveState]:
    """Drives among these that close a loop, with their state."""
    states = {node: state_of(word) for (node, index), word in said.items() if index == STATUSWORD}
    return {node: state for node, state in states.items() if state in POWERED_STATES}


def _holder(said: Mapping[_Place, int]) -> int:
    """Who holds the control token; 0 for nobody, or where there is no such node."""
    return next((holder for (_, index), holder in said.items() if index == TOKEN), 0)


def _asked(access: ObjectAccess, places: Sequence[_Place]) -> dict[_Place, int]:
    """What those say that have an answer, all of them asked at once: one that is not there takes its time."""

    def ask(place: _Place) -> int | None:
        try:
            return int.from_bytes(access.read_once(*place), "little")
        except HardwareError:
            return None

    with ThreadPoolExecutor(max(len(places), 1)) as pool:
        answers = zip(places, pool.map(ask, places), strict=True)
        return {place: answer for place, answer in answers if answer is not None}


def _patience_s(access: ObjectAccess, nodes: Iterable[int]) -> float:
    """How long whoever works here can be late before these let go: drives of their loops, a supervisor of the token."""
    patience_s = LEAST_S
    for node in nodes:
        try:
            patience_s = max(patience_s, MARGIN * (operator_timeout_s(access, node) or 0.0))
        except BusError:
            continue
    return patience_s

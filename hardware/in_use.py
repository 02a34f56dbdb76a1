"""Is somebody at work on this arm who is not heard just now? Asked by SDO before its nodes are reset.

An operator may be late, as this program may be: its drives put up with that for as long as they are told to
(1016h). A reset of their communication meanwhile would strike an arm that moves. So an arm whose drives are
enabled, or whose control token somebody holds, is listened to for as long as they would wait themselves:
whoever is alive is heard by then, and without him they have let go. Where nothing is found, nobody waits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from math import ceil
from typing import Final

from hardware.arm import DriveState
from hardware.cia402 import POWERED
from hardware.drive_facts import misses_operator_after_s
from hardware.errors import BusError, ControlDenied, HardwareError, InUse
from hardware.node_watch import NodeWatch
from hardware.objects import STATUSWORD, TOKEN
from hardware.profile import BusProfile
from hardware.sdo import ObjectAccess
from hardware.steps import state_of

LEAST_S: Final = 1.0
"""Of drives that do not say how long they wait; and the supervisor's token has lapsed by then."""
MARGIN: Final = 1.5
"""On what they say, for their reaction and for answers that come late."""
LOOK_AGAIN_S: Final = 0.1


def require_unused(
    access: ObjectAccess, nodes: NodeWatch, listen: Callable[[float], None], *, takes_over: bool
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
    InUse
        Drives stay enabled for longer than they would wait for an operator.
    """
    profile = nodes.profile
    enabled, held = _enabled(access, profile.drives), _holder(access, profile)
    if not enabled and not held:
        return
    patience_s = _patience_s(access, enabled)
    for _ in range(ceil(patience_s / LOOK_AGAIN_S)):
        listen(LOOK_AGAIN_S)
        if held in nodes.strangers:
            raise ControlDenied(held)
        enabled, held = _enabled(access, enabled), _holder(access, profile)
        if not enabled and not held:
            return
    if enabled and not takes_over:
        named = [f"{profile.who(node)} is in {state.value}" for node, state in enabled.items()]
        raise InUse(named, patience_s)


def _enabled(access: ObjectAccess, nodes: Iterable[int]) -> dict[int, DriveState]:
    """Drives among these that close a loop, with their state."""
    words = _asked(access, nodes, STATUSWORD)
    states = {node: state_of(word) for node, word in words.items()}
    return {node: state for node, state in states.items() if state in POWERED}


def _holder(access: ObjectAccess, profile: BusProfile) -> int:
    """Who holds the control token; 0 for nobody, or where there is no such node."""
    supervisor = profile.supervisor
    if supervisor is None:
        return 0
    return _asked(access, (supervisor,), TOKEN).get(supervisor, 0)


def _asked(access: ObjectAccess, nodes: Iterable[int], index: int) -> dict[int, int]:
    """What those say that have an answer, all of them asked at once: one that is not there takes its time."""

    def ask(node: int) -> int | None:
        try:
            return int.from_bytes(access.read_once(node, index), "little")
        except HardwareError:
            return None

    numbers = tuple(nodes)
    with ThreadPoolExecutor(max(len(numbers), 1)) as pool:
        answers = zip(numbers, pool.map(ask, numbers), strict=True)
        return {node: answer for node, answer in answers if answer is not None}


def _patience_s(access: ObjectAccess, enabled: Iterable[int]) -> float:
    """How long whoever works here can be late before these drives let go."""
    patience_s = LEAST_S
    for node in enabled:
        try:
            patience_s = max(patience_s, MARGIN * (misses_operator_after_s(access, node) or 0.0))
        except BusError:
            continue
    return patience_s

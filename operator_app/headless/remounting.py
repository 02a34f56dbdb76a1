"""Between two placements of the fixture: what the operator has to do, and that it was done. Knows no bus.

Nobody commands the arm meanwhile; that its drives are off is said where they were looked at. That the fixture
was mounted anew goes into the journal when somebody has said so and before the arm is connected again, so that a
session goes on in the right placement whatever happens in between.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from operator_app.errors import SessionError
from operator_app.headless.console import ConsoleListener
from operator_app.session.workflow.opening import Opening, resume
from operator_app.session.workflow.placements import keep_remounted, remounting_steps

_WORD = "mounted"
"""A word, and not Enter: that may be left from before, and the arm moves on it."""


def next_placement(
    opening: Opening, listener: ConsoleListener, *, root: Path, drives_off: bool = False
) -> Opening:
    """Ask for the next placement, keep that it is there, and return how the session goes on.

    `drives_off`: this program has just let go of the arm, and its drives said that they are off.
    Where the arm is simulated by this very program nobody has to do anything.

    Raises
    ------
    SessionError
        Nobody confirmed it.
    """
    listener.close()
    # Which bus it really was the journal says: the choices may have left that to the environment.
    opening = resume(str(opening.folder), opening.choices, root=root)
    number, wanted = opening.placement + 1, opening.procedure.placements
    if opening.choices.interface == "virtual":
        listener.say(f"Placement {number} of {wanted}: the virtual fixture is mounted anew.")
    else:
        with _interrupted_in_words(opening, listener):
            for line in words(opening, drives_off=drives_off):
                listener.say(line)
            _confirmed(opening, number)
    keep_remounted(opening.folder, number)
    return resume(str(opening.folder), opening.choices, root=root)


def require_mounted(opening: Opening, listener: ConsoleListener) -> None:
    """Ask whether a placement is mounted of which nothing is known but that it was to come; keep the answer.

    Raises
    ------
    SessionError
        Nobody confirmed it.
    """
    if not opening.unseen:
        return
    if opening.choices.interface != "virtual":
        with _interrupted_in_words(opening, listener):
            listener.say(
                f"Placement {opening.placement} has no pose yet. Type {_WORD} and Enter when its fixture is "
                "mounted and nobody is within reach: the arm will move."
            )
            _confirmed(opening, opening.placement)
    keep_remounted(opening.folder, opening.placement)


@contextmanager
def _interrupted_in_words(opening: Opening, listener: ConsoleListener) -> Iterator[None]:
    """Say what is left of a run that Ctrl-C or a signal ends while its fixture is being mounted."""
    try:
        yield
    except KeyboardInterrupt:
        listener.say(
            "The run was interrupted while the fixture was being mounted. Nobody commands the arm; every pose "
            f"is kept in {opening.folder}."
        )
        listener.say(f"Go on with: sarcal run --resume {opening.folder}")
        raise


def _confirmed(opening: Opening, number: int) -> None:
    """Wait for the word; what was typed before the question is no answer to it."""
    if sys.stdin.isatty():
        import termios

        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    while line := sys.stdin.readline():
        if line.strip().lower() == _WORD:
            return
    raise SessionError(
        f"nobody confirmed that the fixture is mounted for placement {number}",
        f"when it is, go on with: sarcal run --resume {opening.folder}",
    )


def words(opening: Opening, *, drives_off: bool) -> tuple[str, ...]:
    """Say what to do between two placements; that drives are off only where they were looked at."""
    off = (
        "Nobody commands the arm any more: its drives are off."
        if drives_off
        else "Nobody here commands the arm, and nobody has looked at its drives: make sure that they are off."
    )
    number = opening.placement + 1
    lines = [
        f"Placement {opening.placement} of {opening.procedure.placements} has its poses.",
        f"{off} Leave its controller on: its counters count.",
        *remounting_steps(opening.procedure),
    ]
    if opening.choices.interface == "loopback":
        again = f"its controller and start it again with --placement {number}"
        lines.append(f"(Of a virtual arm: end {again}.)")
    lines.append(
        f"Type {_WORD} and Enter when placement {number} is mounted and nobody is within reach: the arm will move. "
        "Ctrl-C leaves; then "
        f"sarcal run --resume {opening.folder} asks again."
    )
    return tuple(lines)

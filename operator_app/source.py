"""Where both faces get their desks: one for a new session or for one that goes on. Knows no screen."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

from hardware.control_loop import Pace
from operator_app.composition import open_arm
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.config.resources import builtin_names
from operator_app.session.desk import Desk
from operator_app.session.folder import SessionEntry, list_sessions
from operator_app.session.journal import JOURNAL_NAME, Journal
from operator_app.session.opening import Choices, Opening, begin, resume
from operator_app.session.workflow import Session


class Source(Protocol):
    """Gives one desk at a time."""

    def new(self, procedure: str | None = None) -> Desk:
        """Begin a session, of another procedure if one is named."""
        ...

    def procedures(self) -> tuple[Procedure, ...]:
        """The procedures a session can follow."""
        ...

    def resumed(self, reference: str) -> Desk:
        """Go on with a session, named by its folder."""
        ...

    def sessions(self) -> tuple[SessionEntry, ...]:
        """All sessions there are, newest first."""
        ...

    def close(self, reason: str) -> None:
        """Close the desk that is open: arm held, journal whole. Safe to call twice."""
        ...


class ComposedSource:
    """Sessions on the arm that the composition root joins.

    Parameters
    ----------
    procedure
        Built-in name or path.
    choices
        What the command line says beside it.
    root
        Folder of session folders.
    speed
        How many times faster than real time the embedded virtual arm runs.

    Attributes
    ----------
    last
        Folder of the session closed last; None when it held nothing.
    """

    def __init__(self, procedure: str, choices: Choices, *, root: Path, speed: float = 1.0) -> None:
        self._procedure, self._choices, self._root = procedure, choices, root
        self._speed = speed
        self._stack = ExitStack()
        self._desk: Desk | None = None
        self.last: Path | None = None

    def new(self, procedure: str | None = None) -> Desk:
        """Begin a session; a procedure that is named stays chosen."""
        named = procedure or self._procedure
        desk = self._open(begin(named, self._choices, root=self._root), "another session was begun")
        self._procedure = named
        return desk

    def procedures(self) -> tuple[Procedure, ...]:
        """The packaged ones."""
        return tuple(load_procedure(name) for name in builtin_names("procedure"))

    def resumed(self, reference: str) -> Desk:
        """Go on with a session."""
        opening = resume(reference, self._choices, root=self._root)
        return self._open(opening, "another session was resumed")

    def sessions(self) -> tuple[SessionEntry, ...]:
        """All sessions, newest first."""
        return list_sessions(self._root)[::-1]

    def close(self, reason: str) -> None:
        """Close desk, arm and embedded controller."""
        desk, self._desk = self._desk, None
        if desk is not None:
            try:
                desk.close(reason)
            finally:
                self._stack.close()
                kept = not remove_if_empty(desk)
                self.last = desk.session.journal.path.parent if kept else None

    def _open(self, opening: Opening, farewell: str) -> Desk:
        """Open a session; the one that was open is closed when nothing can go wrong any more."""
        with ExitStack() as stack:
            rig = stack.enter_context(open_arm(opening, pace=Pace.REAL_TIME, speed=self._speed))
            journal = (Journal.resume if opening.resumed else Journal.create)(opening.folder)
            stack.callback(journal.close)
            session = Session(journal=journal, arm=rig.arm, procedure=rig.procedure)
            if opening.resumed:
                session.record("resumed", {"settings": dict(opening.settings)})
            else:
                session.open(opening.sources, opening.settings)
            desk = Desk(session, simulated=rig.simulated, bus=_bus_words(opening, rig.simulated))
            opened = stack.pop_all()
        self.close(farewell)
        self._desk, self._stack = desk, opened
        return desk


def _bus_words(opening: Opening, simulated: bool) -> str:  # noqa: FBT001 - one meaning only
    """Interface, channel and bitrate as the operator named them."""
    if simulated:
        return "the virtual bus of this program"
    chosen, own = opening.choices, opening.procedure.bus
    parts = [chosen.interface or own.interface, chosen.channel or own.channel or ""]
    bitrate = chosen.bitrate or own.bitrate
    parts.append(f"{bitrate} bit/s" if bitrate else "")
    return " ".join(p for p in parts if p)


def remove_if_empty(desk: Desk) -> bool:
    """Take away the folder of a session in which no arm was ever connected: it holds nothing."""
    folder = desk.session.journal.path.parent
    if not folder.is_dir():
        return True
    if desk.session.state.serial_number or [p.name for p in folder.iterdir()] != [JOURNAL_NAME]:
        return False
    (folder / JOURNAL_NAME).unlink()
    folder.rmdir()
    return True

"""Session folders: naming new ones, their files, listing what there is. Knows journals, no arm."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from operator_app.config.resources import expanded
from operator_app.errors import JournalError, SessionError
from operator_app.session.store.journal import read_journal
from operator_app.session.store.journal_files import names_from
from operator_app.session.store.journal_format import JOURNAL_NAME, first_event
from operator_app.session.store.replay import order_of, session_state

if TYPE_CHECKING:
    from operator_app.session.store.state import SessionState

STAMP, STAMPED = "%Y%m%d-%H%M%S", re.compile(r"\d{8}-\d{6}-")
"""When a session was begun, at the head of its folder's name."""

PARAMETERS_NAME = "parameters.yaml"
POSES_NAME = "poses.csv"
"""What stands beside a journal once there is something to export."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionEntry:
    """One session folder.

    `problem` says why its journal cannot be read, and `remedy` what to do; `state` is None then.
    """

    folder: Path
    state: SessionState | None
    torn: str
    problem: str
    remedy: str = ""


def new_folder(root: Path, name: str, utc: datetime) -> Path:
    """Return a folder for a new session that does not exist yet, e.g. ``20261121-093000-hinge``.

    Until a journal is made in it, another program may be faster: `Journal.create_beside`.
    """
    stem = f"{utc:{STAMP}}-{re.sub(r'[^A-Za-z0-9_-]+', '-', name)}"
    return next(f for f in names_from(root / stem) if not f.exists())


def next_order(root: Path, *, but: Path | None = None) -> int:
    """Which one a session that begins now is below `root`: one more than any there says of itself.

    Its own folder, `but`, does not count.
    """
    try:
        folders = [p for p in root.iterdir() if p != but]
    except OSError:
        return 1
    return 1 + max((_order_in(p / JOURNAL_NAME) for p in folders), default=0)


def _order_in(path: Path) -> int:
    opened = first_event(path) if os.path.lexists(path) else None
    return 0 if opened is None else order_of(opened.data)


def find_session(root: Path, reference: str) -> Path:
    """Return the folder of a session named by path, by name below `root`, or ``latest``."""
    if reference == "latest":
        # Poses taken to verify another session are nobody's calibration; one that never came as far
        # as a pose is meant only where there is no other.
        found = [
            entry
            for entry in list_sessions(root)
            if entry.state is None or not entry.state.settings.get("verifies")
        ]
        readable = [entry for entry in found if entry.state is not None]
        with_poses = [entry for entry in readable if entry.state and entry.state.captured]
        if found:
            return (with_poses or readable or found)[-1].folder
        raise SessionError(f"there is no session in {root}", "run `sarcal run hinge` first")
    for candidate in (expanded(reference), root / reference):
        if os.path.lexists(candidate / JOURNAL_NAME):
            return candidate
    raise SessionError(
        f"{reference} is no session: there is no {JOURNAL_NAME} in it",
        f"name a session folder, or `latest`; `sarcal session list` shows those in {root}",
    )


def read_session(folder: Path) -> SessionEntry:
    """Read one session without locking it."""
    try:
        contents = read_journal(folder)
        state = session_state(contents)
    except JournalError as error:
        return SessionEntry(
            folder=folder, state=None, torn="", problem=error.happened, remedy=error.remedy
        )
    return SessionEntry(folder=folder, state=state, torn=contents.torn, problem="")


def list_sessions(root: Path) -> tuple[SessionEntry, ...]:
    """Return all sessions below `root`, in the order in which they were begun, whatever was done to the clock."""
    try:
        folders = sorted(p for p in root.iterdir() if os.path.lexists(p / JOURNAL_NAME))
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise SessionError(
            f"cannot look into {root}: {error.strerror}", "name another folder with --sessions"
        ) from error
    entries = [read_session(folder) for folder in folders]
    begun = _begun(entries)
    return tuple(
        sorted(
            entries,
            key=lambda e: (e.state.order if e.state else 0, *begun[e.folder.name], e.folder),
        )
    )


def _begun(entries: Sequence[SessionEntry]) -> dict[str, tuple[str, int]]:
    """Of each folder: when it was begun, and as which one since the clock was set back to before that.

    Journals of earlier versions, which have no `order`, go by it.
    """
    states = {entry.folder.name: entry.state for entry in entries}
    found: dict[str, tuple[str, int]] = {}
    for entry in entries:
        chain, name = list[str](), entry.folder.name
        while name in states and name not in found and name not in chain:
            chain.append(name)
            state = states[name]
            name = state.after if state else ""
        before = found.get(name, ("", 0))
        for name in reversed(chain):
            state = states[name]
            own = state.opened_utc if state else ""
            before = (before[0], before[1] + 1) if before[0] >= own > "" else (own, 0)
            found[name] = before
    return found

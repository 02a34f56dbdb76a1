"""Session folders: their names and files; lists the sessions in the order of opening."""

import os
import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from operator_app.config.errors import ConfigError
from operator_app.config.resources import expanded
from operator_app.errors import JournalError, SessionError
from operator_app.session.store.journal import read_journal
from operator_app.session.store.journal_format import JOURNAL_NAME, first_event, free_path
from operator_app.session.store.replay import order_of, session_state
from operator_app.session.store.state import SessionState

PARAMETERS_NAME = "parameters.yaml"
POSES_NAME = "poses.csv"
"""Files that an export writes beside the journal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionEntry:
    """One session folder.

    `state` is None if the journal cannot be read; `problem` and `remedy` then state why, and what to do. `torn` is the
    message about an incomplete last line; empty if the last line is complete.
    """

    folder: Path
    state: SessionState | None
    torn: str = ""
    problem: str = ""
    remedy: str = ""


def new_folder(root: Path, name: str, utc: datetime) -> Path:
    """Return the path of a new session folder, e.g. ``20261121-093000-hinge``, without creating it.

    If another program creates it first, `Journal.create` takes the next free name.
    """
    return free_path(root / f"{utc:%Y%m%d-%H%M%S}-{re.sub(r'[^A-Za-z0-9_-]+', '-', name)}")


def next_order(new: Path) -> int:
    """Return the order number of a new session in folder `new`: 1 more than the largest in the folders beside it."""
    try:
        folders = [p for p in new.parent.iterdir() if p != new]
    except OSError:
        return 1
    opened = (first_event(folder / JOURNAL_NAME) for folder in folders)
    return 1 + max((order_of(event.data) for event in opened if event is not None), default=0)


def find_session(root: Path, reference: str) -> Path:
    """Find session `reference` (path, name below `root`, or ``latest``) or raise SessionError; return its folder."""
    if reference == "latest":
        # Leave out sessions that only verify another session; prefer sessions with poses.
        sessions = [
            entry
            for entry in reversed(list_sessions(root))
            if entry.state is None or not entry.state.settings.get("verifies")
        ]
        if sessions:
            return max(sessions, key=lambda e: e.state.captured > 0 if e.state else -1).folder
        raise SessionError(f"there is no session in {root}", "run `sarcal run hinge` first")
    for candidate in (expanded(reference), root / reference):
        if os.path.lexists(candidate / JOURNAL_NAME):
            return candidate
    raise SessionError(
        f"'{reference}' is not a session: it contains no {JOURNAL_NAME}",
        f"name a session folder, or `latest`; `sarcal session list` shows those in {root}",
    )


def read_session(folder: Path) -> SessionEntry:
    """Read one session, without locking it."""
    try:
        contents = read_journal(folder)
        state = session_state(contents)
    except JournalError as error:
        return SessionEntry(folder=folder, state=None, problem=error.happened, remedy=error.remedy)
    return SessionEntry(folder=folder, state=state, torn=contents.torn)


def documents_of(state: SessionState) -> tuple[str, str]:
    """Return the procedure's name, and a text with its arm and fixture; "not known" and "" if it is unreadable."""
    from operator_app.config.strict_yaml import load_strict

    try:
        document = load_strict(state.sources["procedure"].encode(), "procedure").data
    except (KeyError, ConfigError):
        return "not known", ""
    known = [str(document[key]) for key in ("arm", "fixture") if key in document]
    return str(document.get("name", "not known")), ", ".join(known)


def list_sessions(root: Path) -> tuple[SessionEntry, ...]:
    """Return all sessions below `root` in the order of opening; those without an order number first, by time."""
    try:
        folders = sorted(p for p in root.iterdir() if os.path.lexists(p / JOURNAL_NAME))
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise SessionError(
            f"cannot read {root}: {error.strerror}", "name another folder with --sessions"
        ) from error
    unread = SessionState()
    opened = [(e.state or unread, e) for e in map(read_session, folders)]
    opened.sort(key=lambda o: (o[0].order, o[0].opened_utc, o[1].folder))
    return tuple(entry for _, entry in opened)

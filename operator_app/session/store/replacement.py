"""When a session made of somebody's poses may take the place of one that is in its folder.

A program that saves is run again, a notebook's cell above all. What an arm took, or a person wrote down, is
taken once: it is replaced by nothing. Knows no arm and no renderer.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from operator_app.config.atomic import write_atomically
from operator_app.errors import JournalError
from operator_app.session.store.journal import lock, read_journal
from operator_app.session.store.journal_format import JOURNAL_NAME, JournalEvent
from operator_app.units.numbers import plural

MADE_AGAIN = frozenset({"opened", "imported", "pose", "solved", "checked", "exported", "closed"})
"""Events that hold nothing which the poses' owner cannot make again."""


def replace_session(
    folder: Path,
    lines: Sequence[bytes],
    events: Sequence[JournalEvent],
    *,
    overwrite: bool,
    stale: Sequence[str],
) -> None:
    """Put these lines where `folder` holds a journal, if that may go; the files named `stale` go first.

    One of the same poses, arm and fixture goes without a word; one of others where `overwrite` says so.

    Raises
    ------
    JournalError
        It holds what cannot be made again, or something else than these poses; it cannot be read, or
        somebody works on it. Nothing was changed then.
    WriteError
        The disk refuses.
    """
    path = folder / JOURNAL_NAME
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise JournalError(
            f"cannot open {path}: {error.strerror}", "name another folder"
        ) from error
    lock(descriptor, path)
    try:
        there = read_journal(folder)
        _require_made_again(folder, there.events)
        if _of_what(there.events) != _of_what(events):
            _require_wanted(folder, there.events, overwrite=overwrite)
        for name in stale:
            # Before the journal: a file of the old calibration never lies beside the new one.
            (folder / name).unlink(missing_ok=True)
        write_atomically(path, b"".join(lines))
    finally:
        os.close(descriptor)


def _require_made_again(folder: Path, events: Sequence[JournalEvent]) -> None:
    names = {event.name for event in events}
    if "imported" in names and names <= MADE_AGAIN:
        return
    raise JournalError(
        f"{folder} holds a session of an arm, or one that somebody worked on",
        "name another folder: what was taken once is not written over, with overwrite=True either",
    )


def _require_wanted(folder: Path, events: Sequence[JournalEvent], *, overwrite: bool) -> None:
    if overwrite:
        return
    poses = plural(sum(event.name == "pose" for event in events), "pose")
    raise JournalError(
        f"there is a session in {folder} already, of other data ({poses})",
        "name another folder, or say that it may go: save(folder, overwrite=True)",
    )


def _of_what(events: Sequence[JournalEvent]) -> list[Any]:
    """What a session was made of: the arm's file and number, the fixture's file, every pose."""
    found: list[Any] = []
    for event in events:
        match event.name:
            case "opened":
                sources = event.data["sources"]
                found += [sources.get(kind) for kind in ("arm", "fixture")]
            case "imported":
                found.append(event.data["serial_number"])
            case "pose":
                found.append(dict(event.data))
    return found

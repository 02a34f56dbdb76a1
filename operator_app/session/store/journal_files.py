"""New files beside a journal, on disk when a call returns; none is ever written over. Knows no line."""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from operator_app.session.store.journal_format import JOURNAL_NAME


def stamped(path: Path, what: str) -> Path:
    """Return a name beside `path` that is not taken: ``journal.jsonl.torn-20261122T030000Z``."""
    stem = f"{path.name}.{what}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    candidate, k = path.with_name(stem), 2
    while os.path.lexists(candidate):
        candidate, k = path.with_name(f"{stem}-{k}"), k + 1
    return candidate


def names_from(folder: Path) -> Iterator[Path]:
    """Return a folder, then others of its name with a number, for as long as they are taken."""
    yield folder
    for k in count(2):
        yield folder.with_name(f"{folder.name}-{k}")


def write_new(path: Path, data: bytes) -> None:
    """Write a file that is not there yet, on disk when this returns; OSError when it cannot be."""
    descriptor = new_file(path)
    try:
        written = 0
        while written < len(data):
            written += os.write(descriptor, data[written:])
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    sync_folder(path.parent)


def new_session(root: Path, stem: str, lines: list[bytes]) -> Path:
    """Write a session folder of these lines below `root`; OSError when it cannot be."""
    folder = next(f for f in names_from(root / stem) if not os.path.lexists(f))
    folder.mkdir(parents=True)
    write_new(folder / JOURNAL_NAME, b"".join(lines))
    sync_folder(root)
    return folder


def new_file(path: Path) -> int:
    """Open a file for appending that is not there yet."""
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)


def sync_folder(folder: Path) -> None:
    """Put on disk which files there are."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

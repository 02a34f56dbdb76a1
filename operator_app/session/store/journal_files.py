"""New files beside a journal: written to disk before a call returns, never over an existing file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from operator_app.session.store.journal_format import JOURNAL_NAME


def timestamped_path(path: Path, what: str) -> Path:
    """Return a free name beside `path`, e.g. ``journal.jsonl.torn-20261122T030000Z``."""
    stem = f"{path.name}.{what}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    candidate, k = path.with_name(stem), 2
    while os.path.lexists(candidate):
        candidate, k = path.with_name(f"{stem}-{k}"), k + 1
    return candidate


def numbered_folders(folder: Path) -> Iterator[Path]:
    """Return `folder`, then the same name with -2, -3, ..."""
    yield folder
    for k in count(2):
        yield folder.with_name(f"{folder.name}-{k}")


def write_new_file(path: Path, data: bytes) -> None:
    """Write a new file to disk; OSError if it exists or cannot be written."""
    descriptor = create_file(path)
    try:
        written = 0
        while written < len(data):
            written += os.write(descriptor, data[written:])
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    fsync_folder(path.parent)


def write_session_folder(root: Path, stem: str, lines: list[bytes]) -> Path:
    """Write a new session folder with a journal of these lines below `root`; OSError if that fails."""
    folder = next(f for f in numbered_folders(root / stem) if not os.path.lexists(f))
    folder.mkdir(parents=True)
    write_new_file(folder / JOURNAL_NAME, b"".join(lines))
    fsync_folder(root)
    return folder


def create_file(path: Path) -> int:
    """Create a file and open it for appending; OSError if it exists."""
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)


def fsync_folder(folder: Path) -> None:
    """Write the entries of a folder to disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

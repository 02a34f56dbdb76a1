"""The journal: an append-only file of what happened, one fsynced and checksummed line an event.

Everything else in a session folder can be made again from it. Knows no event's meaning.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from operator_app.errors import JournalError

JOURNAL_NAME = "journal.jsonl"
SCHEMA = "sarcal/journal/1"

Clock = Callable[[], datetime]


def utc_now() -> datetime:
    """Return the wall clock in UTC."""
    return datetime.now(UTC)


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One line of the journal."""

    seq: int
    utc: str
    name: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalContents:
    """What a journal holds. `torn` says, in words, what was dropped from its end (empty: nothing)."""

    events: tuple[Event, ...]
    torn: str


class Journal:
    """An open, locked journal. Lines are on disk when `append` returns."""

    def __init__(self, path: Path, descriptor: int, contents: JournalContents, chain: str) -> None:
        self.path = path
        self.contents = contents
        self._descriptor = descriptor
        self._seq = len(contents.events)
        self._chain = chain
        self._broken = ""
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="sarcal-journal")

    @classmethod
    def create(cls, folder: Path) -> Journal:
        """Start a journal in a new or empty `folder`; JournalError if there is one already."""
        path = folder / JOURNAL_NAME
        try:
            folder.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
            descriptor = os.open(path, flags, 0o644)
        except FileExistsError as error:
            raise JournalError(
                f"{path} exists already",
                f"resume it with --resume {folder}, or name another folder",
            ) from error
        except OSError as error:
            raise JournalError(
                f"cannot write {path}: {error.strerror}",
                "choose a folder you may write to",
            ) from error
        _lock(descriptor, path)
        _sync_folder(folder)
        return cls(path, descriptor, JournalContents(events=(), torn=""), "")

    @classmethod
    def resume(cls, folder: Path) -> Journal:
        """Open the journal of `folder` to go on; a torn last line is cut off and reported."""
        path = folder / JOURNAL_NAME
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CLOEXEC)
        except OSError as error:
            raise JournalError(
                f"cannot open {path}: {error.strerror}",
                "name a session folder; `sarcal session list` shows them",
            ) from error
        _lock(descriptor, path)
        contents, chain, good_bytes = _parse(path.read_bytes(), path)
        if contents.torn:
            os.ftruncate(descriptor, good_bytes)
            os.fsync(descriptor)
        return cls(path, descriptor, contents, chain)

    def append(self, name: str, data: Mapping[str, Any], *, clock: Clock = utc_now) -> Event:
        """Write one event; returns when it is on disk. A line that cannot be is taken back.

        The writing is done by a thread of its own: a signal that interrupts the caller at any
        moment leaves the line whole and the next one numbered right.
        """
        return self._writer.submit(self._append, name, data, clock).result()

    def _append(self, name: str, data: Mapping[str, Any], clock: Clock) -> Event:
        if self._broken:
            raise JournalError(
                f"{self.path} takes no more lines: {self._broken}",
                "repair the disk, then resume this session and look at its last entry",
            )
        event = Event(
            seq=self._seq + 1,
            utc=clock().isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            name=name,
            data=data,
        )
        body = _body(event)
        chain = _checksum(self._chain, body)
        line = f'{body[:-1]},"sum":"{chain}"}}\n'.encode()
        try:
            self._write(line)
        except OSError as error:
            raise JournalError(
                f"cannot write {self.path}: {error.strerror}",
                "free space or repair the disk, then resume this session; "
                "nothing accepted so far is lost",
            ) from error
        self._seq, self._chain = event.seq, chain
        return event

    def _write(self, line: bytes) -> None:
        """Put a line on disk, or leave the file as it was."""
        size = os.fstat(self._descriptor).st_size
        try:
            if os.write(self._descriptor, line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._descriptor)
        except OSError:
            # Any part of it, even a whole line, would make the next one look damaged.
            self._take_back(size)
            raise

    def _take_back(self, size: int) -> None:
        try:
            os.ftruncate(self._descriptor, size)
            os.fsync(self._descriptor)
        except OSError as error:
            self._broken = f"one that was refused could not be taken back ({error.strerror})"

    @property
    def closed(self) -> bool:
        """Whether `close` has been called."""
        return self._descriptor < 0

    def close(self) -> None:
        """Finish what is being written and release the journal. Safe to call twice."""
        self._writer.shutdown()
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def read_journal(folder: Path) -> JournalContents:
    """Read a journal without locking or changing it."""
    path = folder / JOURNAL_NAME
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise JournalError(
            f"cannot read {path}: {error.strerror}",
            "name a session folder; `sarcal session list` shows them",
        ) from error
    return _parse(raw, path)[0]


def _parse(raw: bytes, path: Path) -> tuple[JournalContents, str, int]:
    """Contents, the last checksum of the chain, and how many bytes are good."""
    events: list[Event] = []
    chain, position, torn = "", 0, ""
    lines = raw.split(b"\n")
    # What follows the last newline is empty in a whole journal.
    complete, rest = lines[:-1], lines[-1]
    for number, line in enumerate(complete, 1):
        problem = ""
        try:
            record = json.loads(line)
            event = Event(
                seq=record["seq"],
                utc=record["utc"],
                name=record["event"],
                data=record["data"],
            )
            expected = _checksum(chain, _body(event))
            if record["sum"] != expected or event.seq != number:
                problem = "its checksum does not fit"
        except (ValueError, KeyError, TypeError):
            problem = "it is not a journal line"
        if problem:
            if number == len(complete) and not rest:
                torn = f"line {number} of {path} was torn ({problem}) and has been dropped"
                break
            raise JournalError(
                f"{path} is damaged at line {number}: {problem}",
                "restore the file from a copy; the lines before it are whole and can be kept",
            )
        events.append(event)
        chain, position = expected, position + len(line) + 1
    if rest:
        torn = f"line {len(complete) + 1} of {path} was torn (cut off) and has been dropped"
    return JournalContents(events=tuple(events), torn=torn), chain, position


def _body(event: Event) -> str:
    record = {
        "seq": event.seq,
        "utc": event.utc,
        "event": event.name,
        "data": event.data,
    }
    return json.dumps(record, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _checksum(previous: str, body: str) -> str:
    """Checksum of a line and, through `previous`, of all lines before it."""
    return hashlib.sha256((previous + body).encode()).hexdigest()[:16]


def _lock(descriptor: int, path: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise JournalError(
            f"{path} is in use by another sarcal",
            "close that one first; one session has one operator",
        ) from error


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

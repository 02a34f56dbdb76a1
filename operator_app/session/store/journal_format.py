"""The lines of a journal: bytes to events and back, and the chain of checksums that proves them.

Tells a torn line (the end was never written) from a damaged one (something changed it afterwards),
and both from a file that is no journal, or none this version can read. Knows no event's meaning.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from operator_app.errors import JournalDamagedError, JournalError, JournalForeignError

JOURNAL_NAME = "journal.jsonl"
SCHEMA = "sarcal/journal/1"
"""States the version of the format, in the first line. Journals from before have no such key."""

LIMIT_BYTES = 256 * 1024 * 1024
"""Some ten thousand poses with a calibration after each; a larger file is another program's."""

KEYS = ("seq", "utc", "event", "data", "sum")
SUM = re.compile(rb',"sum":"([0-9a-f]{16})"\}')
"""How a line ends."""
VERSION = re.compile(r"sarcal/journal/([1-9][0-9]{0,8})")
BEGINNINGS = (b'{"schema":"sarcal/journal/', b'{"seq":1,"utc":"')
CHANGED = 3
"""Bytes in which the beginning of a damaged journal may differ from one of these."""
HALF = re.compile("[\ud800-\udfff]")


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalEvent:
    """One line of the journal."""

    seq: int
    utc: str
    name: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalContents:
    """What a journal holds. `torn` says, in words, what its end does not hold (empty: nothing).

    `file` names it in messages.
    """

    events: tuple[JournalEvent, ...]
    torn: str
    file: str = JOURNAL_NAME


@dataclass(frozen=True, slots=True, kw_only=True)
class Parsed:
    """A journal's bytes, read: its contents, the last checksum, and how many bytes are whole lines."""

    contents: JournalContents
    chain: str
    whole_bytes: int


class BadLineError(Exception):
    """A complete line does not prove itself; the text says why."""


def line_of(event: JournalEvent, chain: str) -> tuple[bytes, str]:
    """Return the line of an event after one with checksum `chain`, and its own checksum.

    Raises
    ------
    ValueError
        The data hold what JSON has no word for.
    """
    head = {"schema": SCHEMA} if event.seq == 1 else {}
    record = {
        **head,
        "seq": event.seq,
        "utc": event.utc,
        "event": event.name,
        "data": event.data,
    }
    text = json.dumps(record, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    # Half a character (of a name that was no UTF-8) has no bytes of its own.
    body = HALF.sub(lambda half: f"\\u{ord(half[0]):04x}", text).encode()
    found = checksum(chain, body)
    return body[:-1] + f',"sum":"{found}"}}\n'.encode(), found


def checksum(previous: str, body: bytes) -> str:
    """Checksum of a line and, through `previous`, of all lines before it."""
    return hashlib.sha256(previous.encode() + body).hexdigest()[:16]


def split_sum(line: bytes) -> tuple[bytes, str] | None:
    """Return what a line says without its checksum, and that; None where it does not end in one."""
    found = SUM.search(line, max(len(line) - 26, 0))
    if found is None or found.end() != len(line):
        return None
    return line[: found.start()] + b"}", found[1].decode()


def proven(line: bytes, number: int, chain: str) -> tuple[JournalEvent, str]:
    """Read a complete line that follows one with checksum `chain`; return its own checksum as well.

    Raises
    ------
    BadLineError
        It is not what was written there.
    JournalForeignError
        It was written there, by a version of this program that is not known here.
    """
    split = split_sum(line)
    if split is None:
        raise BadLineError("it is not a journal line")
    body, stated = split
    if checksum(chain, body) != stated:
        raise BadLineError("its checksum does not fit")
    return event_of(line, number), stated


def event_of(line: bytes, number: int, *, any_number: bool = False) -> JournalEvent:
    """Read a line whose bytes are known to be whole; raises as `proven`.

    `any_number` takes it wherever it says it was: lines before it may be gone.
    """
    try:
        record = json.loads(line, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise BadLineError("it is not a journal line") from error
    if not isinstance(record, dict):
        raise BadLineError("it is not a journal line")
    schema = record.pop("schema", None) if number == 1 or any_number else None
    if schema is not None and schema != SCHEMA:
        raise JournalForeignError(*_other_version(schema))
    seq, utc, name, data = (record.get(key) for key in KEYS[:-1])
    if (
        set(record) != set(KEYS)
        or type(seq) is not int
        or not isinstance(utc, str)
        or not isinstance(name, str)
        or not isinstance(data, dict)
    ):
        raise BadLineError("it is not a journal line")
    if seq != number and not any_number:
        raise BadLineError(f"it says that it is line {seq}")
    return JournalEvent(seq=seq, utc=utc, name=name, data=data)


def parse(raw: bytes, path: Path) -> Parsed:
    """Read the bytes of a journal.

    Raises
    ------
    JournalDamagedError
        A complete line is not what was written.
    JournalForeignError
        It is another program's file, or of a version that is not known here.
    """
    # What follows the last newline is empty in a whole journal.
    *complete, rest = raw.split(b"\n")
    require_ours(complete, rest, path)
    events: list[JournalEvent] = []
    chain, position = "", 0
    for number, line in enumerate(complete, 1):
        try:
            event, chain = proven(line, number, chain)
        except JournalForeignError as error:
            raise JournalForeignError(f"{path} {error.happened}", error.remedy) from error
        except BadLineError as error:
            raise JournalDamagedError(
                path=path, line=number, problem=str(error), events=len(events)
            ) from error
        events.append(event)
        position += len(line) + 1
    torn = ""
    if rest:
        torn = f"line {len(complete) + 1} of {path} was torn (cut off) and does not count"
    contents = JournalContents(events=tuple(events), torn=torn, file=str(path))
    return Parsed(contents=contents, chain=chain, whole_bytes=position)


def read_regular(path: Path) -> bytes:
    """Return the bytes of a journal; one clear error for what is no file of a size it can have."""
    try:
        # A pipe would keep us waiting for whoever writes to it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            require_regular(descriptor, path)
            raw = _read(descriptor, LIMIT_BYTES + 1)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise JournalError(
            f"cannot read {path}: {error.strerror}",
            "name a session folder; `sarcal session list` shows them",
        ) from error
    if len(raw) > LIMIT_BYTES:
        raise JournalForeignError(
            f"{path} is larger than {LIMIT_BYTES // 1024**2} MiB: no journal of this program is",
            "move it away, or name another session",
        )
    return raw


def first_event(path: Path) -> JournalEvent | None:
    """Return what a journal begins with, whatever its other lines are; None where that cannot be told."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            require_regular(descriptor, path)
            line = file.readline(LIMIT_BYTES)
        return proven(line.removesuffix(b"\n"), 1, "")[0]
    except (OSError, BadLineError, JournalForeignError):
        return None


def _read(descriptor: int, limit: int) -> bytes:
    parts: list[bytes] = []
    while limit > 0 and (part := os.read(descriptor, min(limit, 1 << 20))):
        parts.append(part)
        limit -= len(part)
    return b"".join(parts)


def require_regular(descriptor: int, path: Path) -> None:
    """Refuse folders, pipes and devices."""
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return
    kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
    kind = next((words for is_kind, words in kinds if is_kind(mode)), "a device")
    raise JournalForeignError(
        f"{path} is {kind}, not a file", "move it away, or name another session"
    )


def require_ours(complete: list[bytes], rest: bytes, path: Path) -> None:
    """Refuse what was never a journal of this program, or is one of another version."""
    first = complete[0] if complete else rest
    if not first and len(complete) < 2:
        raise JournalForeignError(
            f"{path} is empty: the session was ended before its first line was written",
            "delete the folder, or restore the file from a copy",
        )
    if any(_alike(first, begin, torn=not complete) for begin in BEGINNINGS) or any(
        SUM.search(line) for line in complete[:100]
    ):
        _require_version(first, path)
        return
    if b"\0" in first[:4096]:
        what = "is a binary file, no journal of this program"
    else:
        what = "is another program's file, no journal of this one: line 1 is none of its lines"
    raise JournalForeignError(f"{path} {what}", "move it away, or restore the journal from a copy")


def _require_version(first: bytes, path: Path) -> None:
    """Refuse a first line that states another version, unless that is damage: its checksum tells."""
    found = re.match(rb'\{"schema":"([^"\\]{0,60})"', first)
    split = split_sum(first)
    if found is None or found[1].decode(errors="replace") == SCHEMA:
        return
    if split is not None:
        mended = split[0].replace(found[1], SCHEMA.encode(), 1)
        if checksum("", mended) == split[1]:
            return
    happened, remedy = _other_version(found[1].decode(errors="replace"))
    raise JournalForeignError(f"{path} {happened}", remedy)


def _other_version(schema: object) -> tuple[str, str]:
    if isinstance(schema, str) and VERSION.fullmatch(schema):
        return (
            f"is of the format {schema}; this program reads {SCHEMA} and what came before",
            "read it with the version of sarcal that wrote it, or a newer one",
        )
    return "is no journal: its schema is unknown", "move it away, or name another session"


def _alike(first: bytes, begin: bytes, *, torn: bool) -> bool:
    """Whether a file begins as a journal does, but for a few bytes that were changed or not written."""
    begin = begin[: len(first)] if torn else begin
    same = sum(a == b for a, b in zip(first, begin, strict=False))
    return same >= len(begin) - CHANGED


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no JSON")

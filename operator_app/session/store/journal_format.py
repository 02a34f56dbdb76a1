"""Format of a journal on disk: JSON lines, each with a checksum of its own content and all earlier lines.

Distinguishes an incomplete last line (power cut), a damaged line (changed later), a file that is not a
journal, and a journal of a newer version. Also names and writes files beside the journal.
"""

import hashlib
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from operator_app.errors import JournalDamagedError, JournalError, JournalForeignError

JOURNAL_NAME = "journal.jsonl"
JOURNAL_SCHEMA = "sarcal/journal/1"
"""Version of the format, in the first line; journals of earlier versions have no such key."""

MAX_BYTES = 256 * 1024 * 1024
"""Size limit of a journal: about ten thousand poses with a calibration after each."""

LINE_KEYS = ("seq", "utc", "event", "data", "sum")
CHECKSUM = re.compile(rb',"sum":"([0-9a-f]{16})"\}')
"""Pattern of the checksum at the end of a line."""
JOURNAL_VERSION = re.compile(r"sarcal/journal/([1-9][0-9]{0,8})")
BEGINNINGS = (b'{"schema":"sarcal/journal/', b'{"seq":1,"utc":"')
LONE_SURROGATE = re.compile("[\ud800-\udfff]")


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalEvent:
    """One line of the journal."""

    seq: int
    utc: str
    name: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalContents:
    """Events of a journal.

    `torn` is the message about an incomplete last line (empty if it is complete), `chain` the last checksum.
    """

    events: tuple[JournalEvent, ...]
    file: Path
    torn: str = ""
    chain: str = ""


class BadLineError(Exception):
    """A complete line is invalid; the text states why."""


@contextmanager
def os_errors_as_journal_errors(problem: str, remedy: str) -> Iterator[None]:
    """Context that converts an OSError into a JournalError with `problem`, the system's reason and `remedy`."""
    try:
        yield
    except OSError as error:
        raise JournalError(f"{problem}: {error.strerror}", remedy) from error


def format_line(event: JournalEvent, chain: str) -> tuple[bytes, str]:
    """Return the line of an event and its checksum; `chain`: checksum of the line before it ("" for the first).

    Raises ValueError if JSON cannot represent the data.
    """
    head = {"schema": JOURNAL_SCHEMA} if event.seq == 1 else {}
    record = {**head, "seq": event.seq, "utc": event.utc, "event": event.name, "data": event.data}
    text = json.dumps(record, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    # A lone surrogate (from a file name that is not UTF-8) has no UTF-8 bytes.
    body = LONE_SURROGATE.sub(lambda half: f"\\u{ord(half[0]):04x}", text).encode()
    new_chain = checksum(chain, body)
    return body[:-1] + f',"sum":"{new_chain}"}}\n'.encode(), new_chain


def format_lines(events: Iterable[JournalEvent]) -> list[bytes]:
    """Return the lines of a whole journal; raises ValueError as `format_line` does."""
    chain, lines = "", list[bytes]()
    for event in events:
        line, chain = format_line(event, chain)
        lines.append(line)
    return lines


def utc_in_words(time: datetime) -> str:
    """Return a time (UTC) as text in the format of journal lines, with milliseconds."""
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def checksum(previous: str, body: bytes) -> str:
    """Return the checksum of a line with content `body`; it also covers `previous`, the checksum of the line before."""
    return hashlib.sha256(previous.encode() + body).hexdigest()[:16]


def split_checksum(line: bytes) -> tuple[bytes, str] | None:
    """Split a line into content and checksum; None if it does not end in a checksum."""
    match = CHECKSUM.search(line, max(len(line) - 26, 0))
    if match is None or match.end() != len(line):
        return None
    return line[: match.start()] + b"}", match[1].decode()


def verified_line(line: bytes, number: int, chain: str) -> tuple[JournalEvent, str]:
    """Verify and parse a line that follows a line with checksum `chain`; return its event and its checksum.

    Raises BadLineError if the checksum does not match or the line is not an event, and JournalForeignError if an
    unknown version of this program wrote the line.
    """
    split = split_checksum(line)
    if split is None:
        raise BadLineError("it is not a journal line")
    body, stated = split
    if checksum(chain, body) != stated:
        raise BadLineError("the checksum does not match")
    return parse_line(line, number), stated


def parse_line(line: bytes, number: int, *, any_number: bool = False) -> JournalEvent:
    """Return the event in a line whose checksum has been verified.

    `number`: expected sequence number; ignored if `any_number` is true, because earlier lines may be lost. Raises
    BadLineError if the line is not an event with this number, and JournalForeignError if its version is unknown.
    """
    try:
        record = json.loads(line, parse_constant=_reject_constant)
    except (ValueError, RecursionError) as error:
        raise BadLineError("it is not a journal line") from error
    if not isinstance(record, dict):
        raise BadLineError("it is not a journal line")
    schema = record.pop("schema", None) if number == 1 or any_number else None
    if schema is not None and schema != JOURNAL_SCHEMA:
        raise JournalForeignError(*_other_version(schema))
    values: list[Any] = [record.get(key) for key in LINE_KEYS[:-1]]
    if set(record) != set(LINE_KEYS) or list(map(type, values)) != [int, str, str, dict]:
        raise BadLineError("it is not a journal line")
    seq, utc, name, data = values
    if seq != number and not any_number:
        raise BadLineError(f"its sequence number is {seq}")
    return JournalEvent(seq=seq, utc=utc, name=name, data=data)


def parse_journal(raw: bytes, path: Path) -> JournalContents:
    """Return the contents of a journal from its bytes.

    Raises JournalDamagedError if a complete line was changed, and JournalForeignError if the bytes are not a journal
    or its version is unknown.
    """
    *complete, rest = raw.split(b"\n")
    require_own_format(complete, rest, path)
    chain, events = "", list[JournalEvent]()
    for number, line in enumerate(complete, 1):
        try:
            event, chain = verified_line(line, number, chain)
        except JournalForeignError as error:
            raise JournalForeignError(f"{path} {error.happened}", error.remedy) from error
        except BadLineError as error:
            raise JournalDamagedError(path=path, line=number, problem=str(error)) from error
        events.append(event)
    torn = ""
    if rest:
        torn = f"line {len(complete) + 1} of {path} is incomplete and was left out"
    return JournalContents(events=tuple(events), torn=torn, file=path, chain=chain)


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a journal; raises JournalError unless it is a regular file of at most `MAX_BYTES`."""
    with (
        os_errors_as_journal_errors(
            f"cannot read {path}", "name a session folder; `sarcal session list` shows them"
        ),
        _open_regular(path) as file,
    ):
        if os.fstat(file.fileno()).st_size > MAX_BYTES:
            raise JournalForeignError(
                f"{path} is larger than {MAX_BYTES // 1024**2} MiB, the limit for a journal",
                "move it away, or name another session",
            )
        return file.read()


def first_event(path: Path) -> JournalEvent | None:
    """Return the first event of a journal; None if it cannot be read."""
    try:
        with _open_regular(path) as file:
            line = file.readline(MAX_BYTES)
        return verified_line(line.removesuffix(b"\n"), 1, "")[0]
    except (OSError, BadLineError, JournalForeignError):
        return None


def _open_regular(path: Path) -> BinaryIO:
    # O_NONBLOCK: opening a pipe must not wait for its writer.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
    kind = next((description for is_kind, description in kinds if is_kind(mode)), "a device")
    raise JournalForeignError(
        f"{path} is {kind}, not a file", "move it away, or name another session"
    )


def require_own_format(complete: list[bytes], rest: bytes, path: Path) -> None:
    """Raise JournalForeignError unless a file's `complete` lines and `rest` are a journal of a known version."""
    first = complete[0] if complete else rest
    if not first and len(complete) < 2:
        raise JournalForeignError(
            f"{path} is empty: the session ended before its first entry was written",
            "delete the folder, or restore the file from a copy",
        )
    torn = not complete and any(begin.startswith(first) for begin in BEGINNINGS)
    begins = torn or first.startswith(BEGINNINGS)
    if begins or any(CHECKSUM.search(line) for line in complete[:100]):
        _require_version(first, path)
        return
    if b"\0" in first[:4096]:
        what = "is a binary file, not a journal"
    else:
        what = "is another program's file: line 1 is not a journal line"
    raise JournalForeignError(f"{path} {what}", "move it away, or restore the journal from a copy")


def _require_version(first: bytes, path: Path) -> None:
    """Raise JournalForeignError if line 1 states an unknown version, unless its checksum shows that this is damage."""
    match = re.match(rb'\{"schema":"([^"\\]{0,60})"', first)
    split = split_checksum(first)
    if match is None or match[1].decode(errors="replace") == JOURNAL_SCHEMA:
        return
    if split is not None:
        mended = split[0].replace(match[1], JOURNAL_SCHEMA.encode(), 1)
        if checksum("", mended) == split[1]:
            return
    happened, remedy = _other_version(match[1].decode(errors="replace"))
    raise JournalForeignError(f"{path} {happened}", remedy)


def _other_version(schema: object) -> tuple[str, str]:
    if isinstance(schema, str) and JOURNAL_VERSION.fullmatch(schema):
        return (
            f"has the format {schema}; this program reads {JOURNAL_SCHEMA} and earlier",
            "read it with the version of sarcal that wrote it, or a newer one",
        )
    return "is not a journal: its schema is unknown", "move it away, or name another session"


def _reject_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not JSON")


def timestamped_path(path: Path, tag: str) -> Path:
    """Return an unused path: `path` with `tag` and the time added, e.g. ``journal.jsonl.torn-20261122T030000Z``."""
    return free_path(path.with_name(f"{path.name}.{tag}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"))


def numbered_paths(path: Path) -> Iterator[Path]:
    """Yield `path`, then the same name with -2, -3, ..."""
    yield path
    for k in count(2):
        yield path.with_name(f"{path.name}-{k}")


def free_path(path: Path) -> Path:
    """Return the first of the `numbered_paths` that does not exist."""
    return next(p for p in numbered_paths(path) if not os.path.lexists(p))


def write_new_file(path: Path, data: bytes) -> None:
    """Write a new file to disk; raises OSError if it exists or cannot be written."""
    with os.fdopen(create_file(path), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    fsync_folder(path.parent)


def create_file(path: Path) -> int:
    """Create a file, open it for appending and return its descriptor; raises OSError if it exists."""
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)


def fsync_folder(folder: Path) -> None:
    """Flush the directory entries of a folder to disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

"""Repairs a damaged journal: restores or removes lines whose checksum does not match; keeps a copy of the original.

The checksum of a line covers its bytes and the checksum of the line before it. The line after a damaged line can be
verified if the checksum of the damaged line can be read. A single flipped bit in a line is found by trying each bit.
"""

import hashlib
import os
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from operator_app.session.store.events import event_problem, joint_count_in
from operator_app.session.store.journal import locked, utc_now
from operator_app.session.store.journal_format import (
    JOURNAL_NAME,
    BadLineError,
    JournalContents,
    JournalEvent,
    checksum,
    format_lines,
    fsync_folder,
    os_errors_as_journal_errors,
    parse_line,
    read_bytes,
    require_own_format,
    timestamped_path,
    utc_in_words,
    write_new_file,
)
from operator_app.session.store.replay import session_state
from operator_app.session.store.state import SessionState

TAIL = len(',"sum":"0123456789abcdef"}')
MAX_BIT_SEARCH_BYTES = 40_000
"""Longest line, in bytes, in which a flipped bit is searched for; the search takes a few seconds."""
BITS = tuple(1 << k for k in range(8))
EVENT_NAME = re.compile(rb'"event":"([a-z_]{1,40})"')
POSE_NUMBER = re.compile(rb'"number":(\d{1,9})[,}]')


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairedLine:
    """A line after the repair. `event`: None if the line is lost. `words`: what was lost or restored; "" if intact."""

    number: int
    event: JournalEvent | None
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairResult:
    """Result of a repair.

    `aside`: copy of the damaged journal, None if nothing was damaged. `torn`: whether the last line is incomplete.
    `state`: the session's state after the repair.
    """

    folder: Path
    aside: Path | None
    lines: tuple[RepairedLine, ...]
    torn: bool
    state: SessionState

    @property
    def lost(self) -> tuple[int, ...]:
        """Numbers of the lines that were removed."""
        return tuple(line.number for line in self.lines if line.event is None)


def repair_journal(folder: Path) -> RepairResult:
    """Repair the journal of a session if it is damaged, and return the result.

    Raises JournalError if the file is not a journal, has an unknown version, is in use, or cannot be written.
    """
    path = folder / JOURNAL_NAME
    *complete, rest = read_bytes(path).split(b"\n")
    require_own_format(complete, rest, path)
    remedy = "free space, or copy the folder to one with write permission"
    problem = os_errors_as_journal_errors(f"cannot repair {path}", remedy)
    with locked(path, os.O_RDWR, remedy), problem:
        lines, torn = examine_lines(read_bytes(path))
        events = [line.event for line in lines if line.event is not None]
        aside = None
        if found := [line for line in lines if line.words]:
            aside = timestamped_path(path, "damaged")
            data = {
                "original": aside.name,
                "lost": [line.number for line in found if line.event is None],
                "restored": [line.number for line in found if line.event is not None],
            }
            utc = utc_in_words(utc_now())
            events.append(JournalEvent(seq=0, utc=utc, name="repaired", data=data))
            _replace_journal(path, aside, events)
        state = session_state(JournalContents(events=_numbered(events), file=path))
    return RepairResult(folder=folder, aside=aside, lines=lines, torn=torn, state=state)


def examine_lines(raw: bytes) -> tuple[tuple[RepairedLine, ...], bool]:
    """Examine every line of a journal; return the results and whether the last line is incomplete."""
    *complete, rest = raw.split(b"\n")
    results: list[RepairedLine] = []
    known: str | None = ""
    for number, line in enumerate([*complete, *([rest] if rest else [])], 1):
        proof = None if known is None else _recover(line, known)
        if proof is None and number > len(complete):
            return _without_invalid(results), True
        if proof is None:
            reason = "it is not a journal line"
            if known is None:
                reason = "cannot be verified: the line before it is lost"
            elif line.rstrip().endswith(b'"}'):
                reason = "the checksum does not match"
            results.append(
                RepairedLine(number=number, event=None, words=f"{reason}{_event_hint(line)}")
            )
            stated = line[-TAIL + 8 : -2]
            known = stated.decode() if re.fullmatch(rb"[0-9a-f]{16}", stated) else None
            continue
        original, known, restored = proof
        try:
            event = parse_line(original, number, any_number=True)
        except BadLineError as error:
            event, restored = None, str(error) + _event_hint(original)
        results.append(RepairedLine(number=number, event=event, words=restored))
    return _without_invalid(results), False


# -- one line ------------------------------------------------------------------------------------


def _recover(line: bytes, previous_sum: str) -> tuple[bytes, str, str] | None:
    """Return the original line, its checksum, and what was restored ("" if nothing); None if the line is lost."""
    chain = _checksum_if_stated(line, previous_sum)
    if chain is not None:
        completed = line[:-TAIL] + f',"sum":"{chain}"}}'.encode()
        exact = completed == line
        return completed, chain, "" if exact else "restored: only the checksum was damaged"
    mended = _with_bit_restored(line, previous_sum)
    if mended is None:
        return None
    restored = "restored: the checksum matches with one bit flipped back"
    return mended, mended[-TAIL + 8 : -2].decode(), restored


def _checksum_if_stated(line: bytes, previous_sum: str) -> str | None:
    """Return a line's correct checksum; None if the checksum at the end of the line differs in more than one byte."""
    if len(line) < TAIL:
        return None
    expected = checksum(previous_sum, line[:-TAIL] + b"}")
    end = f',"sum":"{expected}"}}'.encode()
    return expected if sum(a != b for a, b in zip(line[-TAIL:], end, strict=True)) <= 1 else None


def _with_bit_restored(line: bytes, previous_sum: str) -> bytes | None:
    """Return the line with one bit flipped so that the stated checksum matches; None if there is no such bit."""
    stated = line[-TAIL + 8 : -2]
    body = line[:-TAIL] + b"}"
    if not TAIL < len(line) <= MAX_BIT_SEARCH_BYTES:
        return None
    begun = hashlib.sha256(previous_sum.encode())
    for k, byte in enumerate(body[:-1]):
        for bit in BITS:
            tried = begun.copy()
            tried.update(bytes((byte ^ bit,)) + body[k + 1 :])
            if tried.hexdigest()[:16].encode() == stated:
                return line[:k] + bytes((byte ^ bit,)) + line[k + 1 :]
        begun.update(body[k : k + 1])
    return None


def _event_hint(line: bytes) -> str:
    name, number = EVENT_NAME.search(line), POSE_NUMBER.search(line)
    if name is None:
        return ""
    pose = f" {number[1].decode()}" if number is not None else ""
    return f"; probably: {name[1].decode().replace('_', ' ')}{pose}"


def _without_invalid(lines: list[RepairedLine]) -> tuple[RepairedLine, ...]:
    """Return the lines; a line with a valid checksum, but data that no session can use, is marked as lost."""
    counted = Counter(
        joints
        for line in lines
        if line.event is not None
        and not event_problem(line.event, None)[1]
        and (joints := joint_count_in(line.event)) is not None
    )
    joints = counted.most_common(1)[0][0] if counted else None
    results, captured = [], 0
    for line in lines:
        event = line.event
        if event is not None:
            key, problem = event_problem(event, joints, captured)
            if not problem and event.name == "pose":
                captured = event.data["number"]
            if problem:
                problem_text = f"the data are invalid: {event.name}.{key}: {problem}"
                line = replace(line, event=None, words=problem_text)  # noqa: PLW2901
        results.append(line)
    return tuple(results)


# -- the new file --------------------------------------------------------------------------------


def _numbered(events: Sequence[JournalEvent]) -> tuple[JournalEvent, ...]:
    return tuple(replace(event, seq=number) for number, event in enumerate(events, 1))


def _replace_journal(path: Path, aside: Path, events: Sequence[JournalEvent]) -> None:
    """Replace the journal atomically; the damaged journal is kept as the file `aside`."""
    new = timestamped_path(path, "repaired")
    try:
        write_new_file(new, b"".join(format_lines(_numbered(events))))
        try:
            os.link(path, aside)
        except OSError:
            # The file system has no hard links.
            write_new_file(aside, path.read_bytes())
        new.replace(path)
    except OSError:
        with suppress(OSError):
            new.unlink()
        raise
    fsync_folder(path.parent)

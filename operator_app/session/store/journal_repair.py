"""A damaged journal made usable again: what proves itself is kept, the rest is set aside and said.

Each line's checksum is made of its own bytes and the checksum before it, so that lines after a damaged
one prove themselves by what it states; one flipped bit is found by trying all. Nothing is guessed: what
cannot be proven does not count. The damaged file is kept untouched beside the repaired one.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from operator_app.errors import JournalError
from operator_app.session.store.events import joints_told, problem_of
from operator_app.session.store.journal import lock, utc_now
from operator_app.session.store.journal_files import stamped, sync_folder, write_new
from operator_app.session.store.journal_format import (
    JOURNAL_NAME,
    BadLineError,
    JournalContents,
    JournalEvent,
    checksum,
    event_of,
    line_of,
    read_regular,
    require_ours,
)
from operator_app.session.store.replay import session_state

if TYPE_CHECKING:
    from operator_app.session.store.state import SessionState

TAIL = len(',"sum":"0123456789abcdef"}')
LONGEST_TRIED = 40_000
"""Bytes of a line in which a flipped bit is searched for; it takes some seconds at most."""
BREAK = 0x0A
BITS = tuple(1 << k for k in range(8))
NAME = re.compile(rb'"event":"([a-z_]{1,40})"')
NUMBER = re.compile(rb'"number":(\d{1,9})[,}]')


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairedLine:
    """What became of a line: `event` is None where it is lost, `words` say why or how."""

    number: int
    event: JournalEvent | None
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Repaired:
    """What a repair came to.

    `aside` is where the damaged journal is now, None where there was nothing to repair; `torn` says
    that its last line was never written to its end.
    """

    folder: Path
    aside: Path | None
    lines: tuple[RepairedLine, ...]
    torn: bool
    state: SessionState

    @property
    def lost(self) -> tuple[int, ...]:
        """Numbers of the lines that count no more."""
        return tuple(line.number for line in self.lines if line.event is None)


def repair(folder: Path) -> Repaired:
    """Repair the journal of a session, if it is damaged.

    Raises
    ------
    JournalError
        It is no journal, of an unknown version, in use, or the disk refuses.
    """
    path = folder / JOURNAL_NAME
    raw = read_regular(path)
    *complete, rest = raw.split(b"\n")
    require_ours(complete, rest, path)
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CLOEXEC)
    lock(descriptor, path)
    try:
        raw = read_regular(path)
        lines, torn = examined(raw)
        kept = [line.event for line in lines if line.event is not None]
        aside = None
        if any(line.words for line in lines):
            aside = stamped(path, "damaged")
            kept.append(_note(lines, aside))
            _put_in_place(path, aside, kept)
        state = session_state(JournalContents(events=_numbered(kept), torn="", file=str(path)))
    except OSError as error:
        raise JournalError(
            f"cannot repair {path}: {error.strerror}",
            "free space, or copy the folder to where you may write",
        ) from error
    finally:
        os.close(descriptor)
    return Repaired(folder=folder, aside=aside, lines=lines, torn=torn, state=state)


def examined(raw: bytes) -> tuple[tuple[RepairedLine, ...], bool]:
    """Judge every line of a journal; and whether its end was never written."""
    *physical, rest = raw.split(b"\n")
    if rest:
        physical.append(rest)
    found: list[RepairedLine] = []
    known: str | None = ""
    torn = False
    while physical:
        number = len(found) + 1
        line = physical.pop(0)
        proof = None if known is None else _proof(line, known, physical)
        if proof is None and rest and not physical:
            # Nothing proves it, and nothing ever ended it.
            torn = True
            break
        if proof is None:
            why = "cannot be proven: the line before it is gone" if known is None else _bad(line)
            found.append(RepairedLine(number=number, event=None, words=f"{why}{_legible(line)}"))
            stated = line[-TAIL + 8 : -2]
            known = stated.decode() if re.fullmatch(rb"[0-9a-f]{16}", stated) else None
            continue
        whole, known, words = proof
        found.append(_read(whole, number, words))
    return _meant(found), torn


# -- one line ------------------------------------------------------------------------------------


def _proof(line: bytes, before: str, after: list[bytes]) -> tuple[bytes, str, str] | None:
    """Return a line as it was written, its checksum, and what had to be put right; None without proof.

    `after` are the lines that follow; one that belongs to this line is taken out of them, and one that
    was taken for a part of it is put there.
    """
    chain = _fits(line, before)
    if chain is not None:
        whole = _ended(line, chain)
        exact = whole == line
        return whole, chain, "" if exact else "its checksum was damaged, what it says was not"
    said = "one flipped bit was put right: with it the checksum fits"
    for k, byte in enumerate(line):
        if byte ^ BREAK in BITS and (chain := _fits(line[:k], before)) is not None:
            if line[k + 1 :]:
                after.insert(0, line[k + 1 :])
            return _ended(line[:k], chain), chain, said
    if after:
        for bit in BITS:
            joined = line + bytes((BREAK ^ bit,)) + after[0]
            if (chain := _fits(joined, before)) is not None:
                after.pop(0)
                return _ended(joined, chain), chain, said
    mended = _mended(line, before)
    return None if mended is None else (mended, mended[-TAIL + 8 : -2].decode(), said)


def _fits(line: bytes, before: str) -> str | None:
    """Return the checksum of a line if its end states it, but for one byte at most."""
    if len(line) < TAIL:
        return None
    found = checksum(before, line[:-TAIL] + b"}")
    end = f',"sum":"{found}"}}'.encode()
    return found if sum(a != b for a, b in zip(line[-TAIL:], end, strict=True)) <= 1 else None


def _ended(line: bytes, chain: str) -> bytes:
    """Return a line with the end that it had."""
    return line[:-TAIL] + f',"sum":"{chain}"}}'.encode()


def _mended(line: bytes, before: str) -> bytes | None:
    """Find the one bit with which the stated checksum fits."""
    stated = line[-TAIL + 8 : -2]
    body = line[:-TAIL] + b"}"
    if not TAIL < len(line) <= LONGEST_TRIED:
        return None
    begun = hashlib.sha256(before.encode())
    for k, byte in enumerate(body[:-1]):
        for bit in BITS:
            tried = begun.copy()
            tried.update(bytes((byte ^ bit,)) + body[k + 1 :])
            if tried.hexdigest()[:16].encode() == stated:
                return line[:k] + bytes((byte ^ bit,)) + line[k + 1 :]
        begun.update(body[k : k + 1])
    return None


def _read(line: bytes, number: int, words: str) -> RepairedLine:
    try:
        event = event_of(line, number, any_number=True)
    except BadLineError as error:
        return RepairedLine(number=number, event=None, words=str(error) + _legible(line))
    return RepairedLine(number=number, event=event, words=words)


def _bad(line: bytes) -> str:
    return "its checksum does not fit" if line.rstrip().endswith(b'"}') else "it is not a line"


def _legible(line: bytes) -> str:
    """Say what can still be read of a lost line: it may have been what an operator decided."""
    name, number = NAME.search(line), NUMBER.search(line)
    if name is None:
        return ""
    pose = f" {number[1].decode()}" if number is not None else ""
    return f"; it seems to have been: {name[1].decode().replace('_', ' ')}{pose}"


def _meant(lines: list[RepairedLine]) -> tuple[RepairedLine, ...]:
    """Take out whole lines that say what no session can mean."""
    told = Counter(
        joints
        for line in lines
        if line.event is not None
        and not problem_of(line.event.name, line.event.data, line.event.utc, None)[1]
        and (joints := joints_told(line.event.name, line.event.data)) is not None
    )
    joints = told.most_common(1)[0][0] if told else None
    found, captured = [], 0
    for line in lines:
        event = line.event
        if event is not None:
            key, problem = problem_of(event.name, event.data, event.utc, joints)
            if not problem and event.name == "pose":
                number = event.data["number"]
                problem = "" if number > captured else f"comes after pose {captured}"
                key, captured = "number", max(captured, number)
            if problem:
                words = f"says what no session can mean: {event.name}.{key} {problem}"
                line = RepairedLine(number=line.number, event=None, words=words)  # noqa: PLW2901
        found.append(line)
    return tuple(found)


# -- the new file --------------------------------------------------------------------------------


def _note(lines: Sequence[RepairedLine], aside: Path) -> JournalEvent:
    """Return the event that says what was done."""
    data: dict[str, Any] = {
        "original": aside.name,
        "lost": [line.number for line in lines if line.event is None],
        "restored": [line.number for line in lines if line.event is not None and line.words],
    }
    utc = utc_now().isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return JournalEvent(seq=0, utc=utc, name="repaired", data=data)


def _numbered(events: Sequence[JournalEvent]) -> tuple[JournalEvent, ...]:
    return tuple(
        JournalEvent(seq=number, utc=e.utc, name=e.name, data=e.data)
        for number, e in enumerate(events, 1)
    )


def _put_in_place(path: Path, aside: Path, events: Sequence[JournalEvent]) -> None:
    """Write the repaired journal; at every moment there is one, and the damaged one is never touched."""
    chain, lines = "", []
    for event in _numbered(events):
        line, chain = line_of(event, chain)
        lines.append(line)
    new = stamped(path, "repaired")
    try:
        write_new(new, b"".join(lines))
        try:
            os.link(path, aside)
        except OSError:
            # A file system without links.
            write_new(aside, path.read_bytes())
        new.replace(path)
    except OSError:
        with suppress(OSError):
            new.unlink()
        raise
    sync_folder(path.parent)

"""The journal survives every cut, notices every change, and belongs to one process."""

import errno
import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operator_app.errors import JournalDamagedError, JournalError
from operator_app.session.store.journal import JOURNAL_NAME, Journal, is_in_use, read_journal
from tests.oracles.journals import written

EVENTS = (("opened", {"a": 1.25}), ("pose", {"mean_rad": [0.1, -2e-17]}), ("note", {"t": "µ\n"}))


def fail(monkeypatch, failing: Mapping[str, tuple[int, ...]], *, short: bool = False) -> None:
    """Let the n-th calls of `os` functions fail, n from 1; a failed write cuts a line, unreported if `short`."""
    calls: Counter[str] = Counter()

    def failing_at_times(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(descriptor: int, *arguments: Any) -> Any:
            calls[name] += 1
            if calls[name] not in failing.get(name, ()):
                return function(descriptor, *arguments)
            if name == "write":
                written = function(descriptor, arguments[0][: len(arguments[0]) // 2])
                if short:
                    return written
            raise OSError(errno.EIO, "the disk failed")

        return call

    for name in ("write", "fsync", "ftruncate"):
        monkeypatch.setattr(os, name, failing_at_times(name, getattr(os, name)))


def begun(folder: Path) -> Journal:
    journal = Journal.create(folder)
    for name, data in EVENTS:
        journal.append(name, data)
    return journal


def write(folder: Path) -> bytes:
    begun(folder).close()
    return (folder / JOURNAL_NAME).read_bytes()


def read(folder: Path) -> list[tuple[str, Mapping[str, Any]]]:
    return [(e.name, e.data) for e in read_journal(folder).events]


def test_a_truncated_journal_keeps_whole_lines_and_reports_the_rest(tmp_path):
    raw = write(tmp_path)
    for cut in range(1, len(raw) + 1):
        (tmp_path / JOURNAL_NAME).write_bytes(raw[:cut])
        assert read(tmp_path) == list(EVENTS)[: raw[:cut].count(b"\n")]
        assert bool(read_journal(tmp_path).torn) == (not raw[:cut].endswith(b"\n"))


def test_resuming_removes_the_torn_line(tmp_path):
    raw = write(tmp_path)
    path = tmp_path / JOURNAL_NAME
    path.write_bytes(raw[:-5])
    journal = Journal.resume(tmp_path)
    assert "line 3" in journal.contents.torn
    (torn,) = tmp_path.glob("journal.jsonl.torn-*")
    assert torn.read_bytes() == raw[:-5].splitlines()[-1]
    journal.append("note", {"t": "after"})
    journal.close()
    assert read(tmp_path) == [*EVENTS[:2], ("note", {"t": "after"})]


@given(position=st.integers(min_value=0), value=st.integers(min_value=0, max_value=255))
def test_every_changed_byte_is_detected(tmp_path_factory, position, value):
    folder = tmp_path_factory.mktemp("journal")
    raw = bytearray(write(folder))
    position %= len(raw)
    if raw[position] == value:
        return
    raw[position] = value
    (folder / JOURNAL_NAME).write_bytes(raw)
    if position == len(raw) - 1:
        # Only a line that does not end can be mistaken for one that was torn in the writing.
        assert read_journal(folder).torn
        assert read(folder) == list(EVENTS)[:-1]
        return
    with pytest.raises(JournalError, match=str(folder)):
        read_journal(folder)


def test_a_session_is_opened_by_one_program_at_a_time_and_not_overwritten(tmp_path):
    journal = begun(tmp_path)
    assert is_in_use(tmp_path)
    with pytest.raises(JournalError, match="in use"):
        Journal.resume(tmp_path)
    journal.close()
    assert not is_in_use(tmp_path)
    assert not is_in_use(tmp_path / "none")
    Journal.resume(tmp_path).close()
    beside = Journal.create(tmp_path)
    beside.close()
    assert beside.path.parent == tmp_path.with_name(f"{tmp_path.name}-2")


def test_non_finite_numbers_are_not_written(tmp_path):
    journal = Journal.create(tmp_path)
    with pytest.raises(ValueError, match="JSON"):
        journal.append("pose", {"x": float("nan")})
    journal.close()
    assert (tmp_path / JOURNAL_NAME).read_bytes() == b""


def test_lines_are_json_with_a_checksum(tmp_path):
    first, *others = write(tmp_path).splitlines()
    assert set(json.loads(first)) == {"schema", "seq", "utc", "event", "data", "sum"}
    assert json.loads(first)["schema"] == "sarcal/journal/1"
    assert first.startswith(b'{"schema":')
    for line in others:
        assert set(json.loads(line)) == {"seq", "utc", "event", "data", "sum"}


@pytest.mark.parametrize(("name", "short"), [("fsync", False), ("write", False), ("write", True)])
def test_a_failed_line_is_removed_and_the_next_is_valid(tmp_path, monkeypatch, name, short):
    journal = begun(tmp_path)
    whole = (tmp_path / JOURNAL_NAME).read_bytes()
    fail(monkeypatch, {name: (1,)}, short=short)
    with pytest.raises(JournalError, match=r"cannot write .*resume this session"):
        journal.append("refused", {})
    assert (tmp_path / JOURNAL_NAME).read_bytes() == whole
    assert journal.append("first after", {}).seq == len(EVENTS) + 1
    assert journal.append("second after", {}).seq == len(EVENTS) + 2
    journal.close()
    names = [*(name for name, _ in EVENTS), "first after", "second after"]
    resumed = Journal.resume(tmp_path)
    assert resumed.contents.torn == ""
    assert [event.name for event in resumed.contents.events] == names
    resumed.close()


@pytest.mark.parametrize(
    "failing",
    [{"fsync": (1,), "ftruncate": (1,)}, {"write": (1,), "ftruncate": (1,)}, {"fsync": (1, 2)}],
    ids=["fsync and truncate", "write and truncate", "both fsyncs"],
)
def test_a_journal_that_cannot_remove_a_failed_line_is_closed(tmp_path, monkeypatch, failing):
    journal = begun(tmp_path)
    fail(monkeypatch, failing)
    with pytest.raises(JournalError, match="cannot write"):
        journal.append("refused", {})
    left = (tmp_path / JOURNAL_NAME).read_bytes()
    for _ in range(2):
        with pytest.raises(
            JournalError, match=r"can no longer be written.*the disk failed.*resume"
        ):
            journal.append("after", {})
    assert (tmp_path / JOURNAL_NAME).read_bytes() == left
    journal.close()
    resumed = Journal.resume(tmp_path)
    remaining = [(event.name, event.data) for event in resumed.contents.events]
    assert remaining[: len(EVENTS)] == list(EVENTS)
    resumed.append("goes on", {})
    resumed.close()
    assert read_journal(tmp_path).events[-1].name == "goes on"


def test_journals_without_version_can_be_read_and_continued(tmp_path):
    path = tmp_path / JOURNAL_NAME
    path.write_bytes(written(EVENTS, version=False))
    assert b"schema" not in path.read_bytes()
    journal = Journal.resume(tmp_path)
    journal.append("after", {})
    journal.close()
    assert read(tmp_path) == [*EVENTS, ("after", {})]


SHAPES: Mapping[str, tuple[Any, str]] = {
    "newer": (
        lambda p: p.write_bytes(newer(p.read_bytes())),
        "has the format sarcal/journal/2; this program reads sarcal/journal/1",
    ),
    "another program's": (lambda p: p.write_text('{"level": "info"}\n' * 3), "another program's"),
    "text": (lambda p: p.write_text("Dear diary,\n"), "another program's"),
    "lines of nothing": (lambda p: p.write_text("\n\n\n"), "another program's"),
    "empty": (lambda p: p.write_bytes(b""), "is empty"),
    "binary": (lambda p: p.write_bytes(bytes(range(256)) * 9), "binary"),
    "folder": (lambda p: (p.unlink(), p.mkdir()), "a folder"),
    "pipe": (lambda p: (p.unlink(), os.mkfifo(p)), "is a pipe"),
    "device": (lambda p: (p.unlink(), p.symlink_to("/dev/zero")), "is a device"),
    "list": (lambda p: p.write_text("[1, 2]\n"), "another program's"),
    "deep": (lambda p: p.write_text('{"seq":1,"utc":"' + "[" * 100_000 + "\n"), "line 1"),
}


def newer(raw: bytes) -> bytes:
    first, rest = raw.split(b"\n", 1)
    body = first.replace(b"journal/1", b"journal/2")[:-26] + b"}"
    digest = hashlib.sha256(body).hexdigest()[:16]
    return body[:-1] + f',"sum":"{digest}"}}\n'.encode() + rest


@pytest.mark.parametrize("shape", SHAPES)
def test_a_file_that_is_no_journal_is_one_error(tmp_path, shape):
    write(tmp_path)
    change, words = SHAPES[shape]
    change(tmp_path / JOURNAL_NAME)
    for opened in (read_journal, Journal.resume):
        with pytest.raises(JournalError) as refused:
            opened(tmp_path)
        assert words in refused.value.happened
        assert str(tmp_path / JOURNAL_NAME) in refused.value.happened
        assert refused.value.remedy


OTHER = written([("opened", {"a": 2.5}), *EVENTS[1:]]).splitlines(keepends=True)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        (b"journal/1", b"journal/3", 1),
        (b'"t":"', b'"u":"', 3),
        # A sound line of another journal, after the first one of this journal.
        (written(EVENTS).splitlines(keepends=True)[1], OTHER[1], 2),
    ],
)
def test_a_changed_or_foreign_line_is_damage_and_not_removed(tmp_path, old, new, line):
    assert old in written(EVENTS)
    raw = written(EVENTS).replace(old, new)
    path = tmp_path / JOURNAL_NAME
    path.write_bytes(raw)
    for opened in (read_journal, Journal.resume):
        with pytest.raises(JournalDamagedError, match=rf"line {line}.*sarcal session repair"):
            opened(tmp_path)
    assert path.read_bytes() == raw


def test_a_partial_character_is_kept(tmp_path):
    """As in a reason typed in a terminal that does not speak UTF-8."""
    journal = Journal.create(tmp_path)
    journal.append("exported", {"forced": "caf\udce9"})
    journal.close()
    (tmp_path / JOURNAL_NAME).read_bytes().decode()
    assert read(tmp_path) == [("exported", {"forced": "caf\udce9"})]


def test_a_linked_journal_is_readable_but_not_writable(tmp_path):
    write(tmp_path / "there")
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / JOURNAL_NAME).symlink_to(tmp_path / "there" / JOURNAL_NAME)
    assert read_journal(tmp_path / "here").events
    with pytest.raises(JournalError, match="is a symbolic link") as refused:
        Journal.resume(tmp_path / "here")
    assert refused.value.remedy.endswith(str(tmp_path / "there"))


def test_session_on_a_read_only_file_system_is_refused_with_a_remedy_that_helps(
    tmp_path, monkeypatch
):
    journal = Journal.create(tmp_path / "s")
    journal.close()
    system_open = os.open

    def read_only(path, flags, *arguments):
        if flags & os.O_RDWR and str(path).endswith(JOURNAL_NAME):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return system_open(path, flags, *arguments)

    monkeypatch.setattr(os, "open", read_only)
    with pytest.raises(JournalError) as refused:
        Journal.resume(tmp_path / "s")
    assert all(part in refused.value.remedy for part in ("writable", "report --text"))
    assert "session list" not in refused.value.remedy

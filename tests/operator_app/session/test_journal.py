"""The journal survives every cut, notices every change, and belongs to one process."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operator_app.session.errors import JournalError
from operator_app.session.journal import JOURNAL_NAME, Journal, read_journal

EVENTS = (("opened", {"a": 1.25}), ("pose", {"mean_rad": [0.1, -2e-17]}), ("note", {"t": "µ\n"}))


def write(folder: Path) -> bytes:
    journal = Journal.create(folder)
    for name, data in EVENTS:
        journal.append(name, data)
    journal.close()
    return (folder / JOURNAL_NAME).read_bytes()


def test_what_is_written_is_read_bit_for_bit(tmp_path: Path) -> None:
    write(tmp_path)
    contents = read_journal(tmp_path)
    assert [(e.name, e.data) for e in contents.events] == list(EVENTS)
    assert contents.torn == ""


def test_every_cut_keeps_all_whole_lines_and_says_what_was_dropped(tmp_path: Path) -> None:
    raw = write(tmp_path)
    path = tmp_path / JOURNAL_NAME
    for cut in range(len(raw) + 1):
        path.write_bytes(raw[:cut])
        whole = raw[:cut].count(b"\n")
        contents = read_journal(tmp_path)
        assert len(contents.events) == whole
        assert bool(contents.torn) == (not raw[:cut].endswith(b"\n") and cut > 0)


def test_resuming_cuts_the_torn_line_off_and_goes_on(tmp_path: Path) -> None:
    raw = write(tmp_path)
    path = tmp_path / JOURNAL_NAME
    path.write_bytes(raw[:-5])
    journal = Journal.resume(tmp_path)
    assert "line 3" in journal.contents.torn
    journal.append("note", {"t": "after"})
    journal.close()
    assert [e.name for e in read_journal(tmp_path).events] == ["opened", "pose", "note"]
    assert read_journal(tmp_path).events[-1].data == {"t": "after"}


@given(position=st.integers(min_value=0), value=st.integers(min_value=0, max_value=255))
def test_no_changed_byte_goes_unnoticed(
    tmp_path_factory: pytest.TempPathFactory, position: int, value: int
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    raw = bytearray(write(folder))
    position %= len(raw)
    if raw[position] == value:
        return
    raw[position] = value
    (folder / JOURNAL_NAME).write_bytes(raw)
    if not contents_or_refusal(folder):
        return
    contents = read_journal(folder)
    # Only the last line can be mistaken for one that was torn in the writing; two lines are the
    # last one when the change took the line break between them.
    assert contents.torn
    kept = [(e.name, e.data) for e in contents.events]
    assert kept == list(EVENTS)[: len(kept)]
    merged = bytes(raw[:-1]).count(b"\n") < len(EVENTS) - 1
    assert len(kept) == len(EVENTS) - (2 if merged else 1)


def contents_or_refusal(folder: Path) -> bool:
    """Whether the journal can be read; a refusal names the file."""
    try:
        read_journal(folder)
    except JournalError as error:
        return str(folder) not in str(error)
    return True


def test_a_line_from_another_journal_does_not_fit(tmp_path: Path) -> None:
    first = write(tmp_path / "one").splitlines(keepends=True)
    journal = Journal.create(tmp_path / "two")
    journal.append("opened", {"a": 2})
    journal.close()
    path = tmp_path / "two" / JOURNAL_NAME
    path.write_bytes(path.read_bytes() + first[1] + first[2])
    with pytest.raises(JournalError, match="line 2"):
        read_journal(tmp_path / "two")


def test_one_session_has_one_operator(tmp_path: Path) -> None:
    journal = Journal.create(tmp_path)
    with pytest.raises(JournalError, match="in use"):
        Journal.resume(tmp_path)
    journal.close()
    Journal.resume(tmp_path).close()


def test_an_existing_session_is_not_overwritten(tmp_path: Path) -> None:
    write(tmp_path)
    with pytest.raises(JournalError, match="exists already"):
        Journal.create(tmp_path)


def test_non_finite_numbers_never_reach_the_file(tmp_path: Path) -> None:
    journal = Journal.create(tmp_path)
    with pytest.raises(ValueError, match="JSON"):
        journal.append("pose", {"x": float("nan")})
    journal.close()
    assert (tmp_path / JOURNAL_NAME).read_bytes() == b""


def test_lines_are_plain_json_with_a_checksum(tmp_path: Path) -> None:
    for line in write(tmp_path).splitlines():
        assert set(json.loads(line)) == {"seq", "utc", "event", "data", "sum"}

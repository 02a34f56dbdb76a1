"""A journal is watched while it is written: taken away, it accepts nothing more and what it held is kept."""

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from operator_app.errors import JournalLostError
from operator_app.session.store.journal import JOURNAL_NAME, Journal, read_journal

EVENTS = (("opened", {"a": 1.25}), ("pose", {"number": 1}))


def replaced(path: Path) -> None:
    raw = path.read_bytes()
    path.unlink()
    path.write_bytes(raw)


def cut(path: Path) -> None:
    os.truncate(path, 50)


def folder_deleted(path: Path) -> None:
    shutil.rmtree(path.parent)


def appended(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"{}\n")


TAKEN_AWAY: Mapping[str, tuple[Callable[[Path], object], str]] = {
    "folder deleted": (folder_deleted, "deleted, moved or renamed"),
    "folder renamed": (lambda p: p.parent.rename(p.parent.with_name("x")), "deleted, moved or"),
    "deleted": (Path.unlink, "deleted, moved or renamed"),
    "renamed": (lambda p: p.rename(p.with_name("mine.jsonl")), "deleted, moved or renamed"),
    "truncated": (cut, "was cut from"),
    "emptied": (lambda p: os.truncate(p, 0), "was cut from"),
    "replaced": (replaced, "was replaced by another file"),
    "written to": (appended, "was written to by another program"),
    "a folder instead": (lambda p: (p.unlink(), p.mkdir()), "was replaced"),
}


@pytest.mark.parametrize("kind", TAKEN_AWAY)
def test_a_journal_that_is_taken_away_accepts_nothing_and_loses_nothing(tmp_path, kind):
    folder = tmp_path / "20261122-hinge"
    journal = Journal.create(folder)
    for name, data in EVENTS:
        journal.append(name, data)
    take, words = TAKEN_AWAY[kind]
    take(folder / JOURNAL_NAME)
    with pytest.raises(JournalLostError, match=words) as lost:
        journal.append("pose", {"number": 2})
    rescued = tmp_path / "20261122-hinge-rescued"
    assert lost.value.rescued == journal.kept_folder == rescued
    assert f"--resume {rescued}" in lost.value.remedy
    found = [(e.name, e.data) for e in read_journal(rescued).events]
    assert found == [*EVENTS, ("pose", {"number": 2})]
    # Neither does it take any more, nor is the rescue written twice.
    for again in (lambda: journal.append("pose", {"number": 3}), journal.require_intact):
        with pytest.raises(JournalLostError, match=words):
            again()
    journal.close()
    assert len(list(tmp_path.glob("*rescued*"))) == 1
    resumed = Journal.resume(rescued)
    resumed.append("goes on", {})
    resumed.close()


def test_what_is_gone_is_noticed_before_the_arm_moves(tmp_path):
    journal = Journal.create(tmp_path / "session")
    journal.append("opened", {})
    journal.require_intact()
    shutil.rmtree(tmp_path / "session")
    with pytest.raises(JournalLostError, match="All entries are in"):
        journal.require_intact()
    journal.close()
    assert [e.name for e in read_journal(journal.kept_folder).events] == ["opened"]


def one_bit(path: Path, line: int) -> None:
    """Change a bit in the middle of a line, in place."""
    raw = bytearray(path.read_bytes())
    position = sum(map(len, bytes(raw).splitlines(keepends=True)[: line - 1])) + 50
    raw[position] ^= 1
    with path.open("r+b") as file:
        file.write(raw)


@pytest.mark.parametrize("line", [1, 2, 3, 4])
@pytest.mark.parametrize("resumed", [False, True])
def test_one_bit_changed_in_place_is_noticed_when_it_is_read_back(tmp_path, line, resumed):
    folder = tmp_path / "session"
    journal = Journal.create(folder)
    for number in range(1, 4):
        journal.append("pose", {"number": number, "note": "x" * 40})
    if resumed:
        journal.close()
        journal = Journal.resume(folder)
    journal.append("solved", {"accepted": True, "note": "y" * 40})
    journal.require_intact(unchanged=True)
    one_bit(folder / JOURNAL_NAME, line)
    with pytest.raises(JournalLostError, match=f"was changed in line {line} while") as lost:
        journal.require_intact(unchanged=True)
    journal.close()
    rescued = lost.value.rescued
    assert rescued is not None
    assert [e.name for e in read_journal(rescued).events] == [*["pose"] * 3, "solved"]


def test_a_rescue_goes_elsewhere_when_there_is_nothing_beside(tmp_path, monkeypatch):
    other = tmp_path / "tmp"
    other.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(other))
    journal = Journal.create(tmp_path / "sessions" / "one")
    journal.append("opened", {})
    shutil.rmtree(tmp_path / "sessions")
    (tmp_path / "sessions").write_text("a file where the sessions were")
    with pytest.raises(JournalLostError):
        journal.append("pose", {})
    journal.close()
    assert journal.kept_folder == other / "one-rescued"
    assert len(read_journal(journal.kept_folder).events) == 2

"""`sarcal session repair_journal`: nothing that can be proven is lost, nothing that cannot be counts."""

from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from operator_app.errors import JournalDamagedError, JournalError
from operator_app.session.store.folders import read_session
from operator_app.session.store.journal import JOURNAL_NAME, Journal, read_journal
from operator_app.session.store.journal_repair import examine_lines, repair_journal
from tests.oracles.journals import events, write_journal, written

SOUND = written(events())
SHORT = written([(name, data) for name, data in events() if name != "opened"])
"""Without the long first line, for what is tried often."""


def broken(raw: bytes, line: int, *, sums: bool = False) -> bytes:
    """The journal with several bytes of a line changed, so that no proof is left; `sums`: of its checksum as well."""
    lines = raw.splitlines(keepends=True)
    changed = bytearray(lines[line - 1])
    for k in (10, 30, len(changed) // 2):
        changed[k] = ord("#")
    if sums:
        changed[-20:-10] = b"##########"
    lines[line - 1] = bytes(changed)
    return b"".join(lines)


def entries(folder: Path) -> list[tuple[str, dict]]:
    return [(e.name, dict(e.data)) for e in read_journal(folder).events]


def test_one_flipped_bit_does_not_lose_a_session(tmp_path):
    raw = bytearray(SOUND)
    raw[2000] ^= 1
    write_journal(tmp_path, bytes(raw))
    with pytest.raises(JournalDamagedError, match="line 1"):
        read_journal(tmp_path)
    repaired = repair_journal(tmp_path)
    assert repaired.lost == ()
    assert repaired.aside.read_bytes() == bytes(raw)
    *remaining, note = entries(tmp_path)
    assert remaining == events()
    assert note == ("repaired", {"original": repaired.aside.name, "lost": [], "restored": [1]})
    # What was concluded still stands: everything that it was made of is there.
    assert repaired.state.solved["accepted"]
    Journal.resume(tmp_path).close()


@settings(max_examples=60)
@given(position=st.integers(0, len(SHORT) - 1), bit=st.integers(0, 7))
def test_any_flipped_bit_in_a_line_is_repaired(position, bit):
    raw = bytearray(SHORT)
    assume(raw[position] != ord("\n") != raw[position] ^ 1 << bit)
    raw[position] ^= 1 << bit
    lines, torn = examine_lines(bytes(raw))
    assert not torn
    remaining = [(line.event.name, line.event.data) for line in lines if line.event is not None]
    assert remaining == [e for e in events() if e[0] != "opened"]
    assert sum(bool(line.words) for line in lines) == 1


@pytest.mark.parametrize(("sums", "lost"), [(False, [9]), (True, [9, 10])])
def test_unproven_lines_are_dropped_reported_and_the_rest_kept(tmp_path, sums, lost):
    write_journal(tmp_path / "last", broken(SOUND, len(events())))
    assert list(repair_journal(tmp_path / "last").lost) == [len(events())]
    write_journal(tmp_path, broken(SOUND, 9, sums=sums))
    repaired = repair_journal(tmp_path)
    assert list(repaired.lost) == lost
    *remaining, note = entries(tmp_path)
    assert remaining == [e for k, e in enumerate(events(), 1) if k not in lost]
    assert note[1]["lost"] == lost
    assert "pose 2" in repaired.lines[8].words
    assert [p.number for p in repaired.state.used_poses] == [1, 4]
    # What was made of those poses does not count any more.
    assert repaired.state.solved == {}
    assert repaired.state.resumed


def test_invalid_content_is_set_aside(tmp_path):
    invalid = events()
    invalid[6][1]["mean_rad"] = [0.1] * 6
    invalid[3][1]["start_rad"] = None
    write_journal(tmp_path, written(invalid))
    repaired = repair_journal(tmp_path)
    assert list(repaired.lost) == [4, 7]
    assert "pose.mean_rad: has 6 items" in repaired.lines[6].words
    assert read_session(tmp_path).problem == ""


def test_an_intact_journal_is_not_changed(tmp_path):
    write_journal(tmp_path, SOUND + b'{"seq":29,"torn')
    repaired = repair_journal(tmp_path)
    assert repaired.aside is None
    assert repaired.torn
    assert (tmp_path / JOURNAL_NAME).read_bytes() == SOUND + b'{"seq":29,"torn'
    assert [p.name for p in tmp_path.iterdir()] == [JOURNAL_NAME]


def test_other_files_are_not_repaired(tmp_path):
    write_journal(tmp_path, b"Dear diary\n")
    with pytest.raises(JournalError, match="another program's file"):
        repair_journal(tmp_path)
    write_journal(tmp_path / "used", SOUND)
    journal = Journal.resume(tmp_path / "used")
    with pytest.raises(JournalError, match="in use"):
        repair_journal(tmp_path / "used")
    journal.close()


def test_the_command_reports_each_line_and_the_session_continues(tmp_path, run_command):
    root = ["--sessions", str(tmp_path)]
    folder = write_journal(tmp_path / "one", broken(SOUND, 9))
    assert f"sarcal session repair {folder}" in run_command(2, "report", "one", *root).err
    assert "name the session" in run_command(2, "session", "repair", *root).err
    text = run_command(0, "session", "repair", "one", *root).words
    assert "untouched in" in text
    assert "lines 1 to 8: kept, verified by their checksum" in text
    assert "line 9: lost: the checksum does not match; probably: pose 2" in text
    assert f"lines 10 to {len(events())}: kept" in text
    assert "2 poses count" in text
    assert f"Go on with: sarcal run --resume {folder}" in text
    assert run_command(0, "session", "show", "one", "--json", *root).json["poses"] == 2
    repaired = run_command(0, "session", "repair", "one", "--json", *root).json
    assert (repaired["repaired"], repaired["original"]) == (False, None)
    assert {line["fate"] for line in repaired["lines"]} == {"kept"}


def test_a_session_without_its_first_line_keeps_poses_but_cannot_continue(tmp_path, run_command):
    write_journal(tmp_path / "one", broken(SOUND, 1))
    text = run_command(0, "session", "repair", "one", "--sessions", tmp_path).out
    assert "cannot be resumed" in text
    assert len(read_session(tmp_path / "one").state.used_poses) == 3

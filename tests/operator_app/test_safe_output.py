"""What somebody else wrote arrives on a screen, in a pipe and in a page as text, whatever is in it."""

import ast
import json
import os
import subprocess
import sys
import unicodedata
from pathlib import Path
from typing import TextIO

import pytest
from hypothesis import given
from hypothesis import strategies as st

import operator_app
from operator_app.cli import main
from operator_app.config.poses_file import load_poses
from operator_app.headless.console import ConsoleListener
from operator_app.headless.plain import StandardTerminal
from operator_app.report.html.markup import element
from operator_app.report.table import Column, FactTable
from operator_app.report.text import aligned, paragraph, table_lines
from operator_app.safe_output import MARK, lines, sanitized, say
from operator_app.session.store.folders import read_session
from operator_app.session.store.journal import JOURNAL_NAME
from operator_app.tui.theme import DARK, look
from tests.oracles.journals import events, written

HOSTILE = "a\x1b[2J\x1b]0;owned\x07b\x9b31mc\u202edlo\u2066x\ry\u2028z\ud800"
"""Clears a screen, names a window, colours by C1, turns text round, breaks lines, is half a character."""

texts = st.one_of(
    st.text(),
    st.text(alphabet="ab\x1b\x9b\x85\u2028\u2029\u202e\u2066\u200f\r\n\t\x07\x00\x7f \u00e9[;m"),
)


def obeyed(text: str, allowed: str = "\n") -> set[str]:
    """Characters in a text that a terminal or a reader would obey, told by Unicode's own categories."""
    bad = ("Cc", "Cf", "Cs", "Zl", "Zp")
    return {c for c in text if unicodedata.category(c) in bad and c not in allowed}


@given(texts)
def test_what_goes_out_is_text_and_as_long_as_before(text):
    out = sanitized(text)
    assert obeyed(out, allowed="") == set()
    assert len(out) == len(text)
    for before, after in zip(text, out, strict=True):
        assert after == before or (after == MARK and not before.isprintable())


@given(st.text(alphabet=st.characters(categories=["L", "M", "N", "P", "S"])))
def test_letters_marks_numbers_and_signs_stay(text):
    assert sanitized(text) == text


@given(texts)
def test_every_way_out_marks_them(text):
    assert obeyed(look(DARK, ascii_only=False).text(text)) == set()
    assert obeyed(look(DARK, ascii_only=True).text(text)) == set()
    assert obeyed(element("p", text, title=text), allowed="\t\r\n") == set()
    row = table_lines(FactTable(ident="t", title="t", columns=(Column("c"),), rows=((text,),)))
    assert obeyed("".join(row), allowed="") == set()
    assert len(aligned([[text, text], ["a", "b"]]).split("\n")) == 2
    assert "\n" not in lines([text])


@given(texts)
def test_wrapped_words_break_no_line_of_their_own(text):
    assert len(paragraph(f"a {text[:20]} b").split("\n")) == 1


def test_the_headless_faces_mark_them(capsys):
    ConsoleListener().say(f"one {HOSTILE}")
    StandardTerminal().say(f"one\ntwo {HOSTILE}")
    found = capsys.readouterr()
    assert obeyed(found.out + found.err) == set()
    assert found.err.count("\n") == 1
    assert found.out.count("\n") == 2


def test_what_is_typed_is_repeated_as_text(tmp_path, capsys, ends_with):
    name = str(tmp_path / "no\x1b[31msuch\nsarcal: all is well\u202e")
    arm = ["--arm", "sarcos_dextrous", "--fixture", "hinge"]
    for words in (
        ["solve", name, *arm],
        ["run", name],
        ["report", name],
        ["compare", name, name],
        ["session", "show", name],
        ["run", "--unsensed", name],
    ):
        said = ends_with(2, *words).err
        assert obeyed(said) == set()
        assert not any(line.startswith("sarcal: all is well") for line in said.splitlines())
    with pytest.raises(SystemExit):
        main(["run", f"--{HOSTILE}"])
    assert obeyed(capsys.readouterr().err) == set()


@pytest.fixture
def odd_pose(reference_data, tmp_path):
    """Write a file of poses of which one is odd, its labels beginning with this."""

    def write(label: str) -> Path:
        source = (reference_data / "hinge" / "hinge_exact.csv").read_text().splitlines()
        rows = [row.split(",") for row in source[:14]]
        for row in rows[1:]:
            row[1] = f'"{label}{row[1]}"'
        rows[5][3] = str(float(rows[5][3]) + 3.0)
        path = tmp_path / "poses.csv"
        path.write_text("\n".join(",".join(row) for row in rows), newline="")
        return path

    return write


def test_labels_of_a_poses_file_stay_in_the_file(odd_pose, ends_with):
    path = odd_pose(HOSTILE.replace("\ud800", "").replace("\x00", ""))
    assert "\x1b[2J" in load_poses(path, joint_count=7).poses.label[0]
    found = ends_with(4, "solve", path, "--arm", "sarcos_dextrous", "--fixture", "hinge")
    assert "owned" in found.out, "the odd pose is named"
    assert obeyed(found.out + found.err) == set()


def hostile_session(folder: Path) -> Path:
    folder.mkdir(parents=True)
    found = events()
    for name, data in found:
        if name == "connected":
            data["serial_number"] = HOSTILE
            data["nodes"][0]["device_name"] = HOSTILE
        if "note" in data or name == "pose_noted":
            data["text" if name == "pose_noted" else "note"] = HOSTILE
    (folder / JOURNAL_NAME).write_bytes(written(found))
    return folder


def test_a_session_keeps_what_was_written_and_shows_it_as_text(tmp_path, ends_with):
    folder = hostile_session(tmp_path / "one")
    root = ["--sessions", str(tmp_path)]
    state = read_session(folder).state
    assert state is not None
    assert state.serial_number == HOSTILE
    listed = ends_with(0, "session", "list", *root).out
    assert len(listed.splitlines()) == 2
    shown = ends_with(0, "session", "show", "one", *root).out
    assert "owned" in listed + shown
    assert obeyed(listed + shown) == set()
    data = ends_with(0, "session", "show", "one", "--json", *root).out
    assert obeyed(data) == set()
    assert json.loads(data)["serial_number"] == HOSTILE


def full() -> TextIO:
    """A stream on a full disk."""
    return Path("/dev/full").open("w", encoding="utf-8", buffering=1)


def unread() -> TextIO:
    """A stream whose reader has gone."""
    reader, writer = os.pipe()
    os.close(reader)
    return os.fdopen(writer, "w", buffering=1, encoding="utf-8")


@pytest.mark.parametrize("stream", [full, unread])
def test_progress_that_cannot_be_written_goes_nowhere(monkeypatch, stream):
    """It ended a calibration in mid-run."""
    with stream() as broken:
        monkeypatch.setattr("sys.stderr", broken)
        for _ in range(3):
            ConsoleListener().say("one line of progress")
            say("another", err=True)


@pytest.mark.parametrize("stream", [full, unread])
def test_of_results_nobody_reads_the_exit_code_is_what_was_found(odd_pose, monkeypatch, stream):
    words = ["solve", str(odd_pose("")), "--arm", "sarcos_dextrous", "--fixture", "hinge"]
    with stream() as broken:
        monkeypatch.setattr("sys.stdout", broken)
        code = main(words)
    # An odd pose is not accepted; a result that is to be kept and cannot be is an error of its own.
    assert code == (4 if stream is unread else 2)


def test_help_on_a_full_disk_is_an_error(monkeypatch):
    with full() as broken:
        monkeypatch.setattr("sys.stdout", broken)
        assert main(["--help"]) == 2


def test_who_watches_ends_by_going(monkeypatch):
    with unread() as broken:
        monkeypatch.setattr("sys.stdout", broken)
        with pytest.raises(BrokenPipeError):
            say("what was seen", streaming=True)


@pytest.mark.sample(2)
@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", ">&- 2>&-"])
def test_closed_streams_are_no_defect(closed, tmp_path):
    """Nor does a file of ours get their numbers."""
    command = f"{sys.executable} -m operator_app.cli session list --sessions {tmp_path} {closed}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "Traceback" not in done.stdout + done.stderr


def test_nothing_prints_but_the_one_function():
    root = Path(operator_app.__file__).parent
    found = [
        f"{path.relative_to(root)}:{node.lineno}"
        for path in root.rglob("*.py")
        if path.name != "words_out.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
    ]
    assert found == []

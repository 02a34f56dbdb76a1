"""Text from files, devices and arguments is shown without control characters; streams that cannot be written."""

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

from operator_app.cli import main
from operator_app.config.poses_file import load_poses
from operator_app.headless.console import ConsoleListener
from operator_app.headless.plain import Terminal
from operator_app.report.html.markup import element
from operator_app.report.table import Column, FactTable
from operator_app.report.text import aligned, paragraph, table_lines
from operator_app.safe_output import MARK, lines, sanitized, say
from operator_app.session.store.folders import read_session
from operator_app.tui.theme import DARK, look
from tests.oracles.journals import events, write_journal, written

SARCOS_HINGE = ("--arm", "sarcos_dextrous", "--fixture", "hinge")
HOSTILE = "a\x1b[2J\x1b]0;owned\x07b\x9b31mc\u202edlo\u2066x\ry\u2028z\ud800"
"""Clears the screen, sets a title, colours by C1, reverses text, breaks lines, has a lone surrogate."""

texts = st.one_of(
    st.text(),
    st.text(alphabet="ab\x1b\x9b\x85\u2028\u2029\u202e\u2066\u200f\r\n\t\x07\x00\x7f \u00e9[;m"),
)


def control_characters(text: str, allowed: str = "\n") -> set[str]:
    """Characters of Unicode's control, format, surrogate and separator categories in a text."""
    categories = ("Cc", "Cf", "Cs", "Zl", "Zp")
    return {c for c in text if unicodedata.category(c) in categories and c not in allowed}


@given(texts)
def test_control_characters_are_replaced_one_by_one(text):
    out = sanitized(text)
    assert control_characters(out, allowed="") == set()
    assert len(out) == len(text)
    for before, after in zip(text, out, strict=True):
        assert after == before or (after == MARK and not before.isprintable())


@given(texts)
def test_every_output_replaces_control_characters(text):
    assert control_characters(look(DARK, ascii_only=False).text(text)) == set()
    assert control_characters(look(DARK, ascii_only=True).text(text)) == set()
    assert control_characters(element("p", text, title=text), allowed="\t\r\n") == set()
    row = table_lines(FactTable(ident="t", title="t", columns=(Column("c"),), rows=((text,),)))
    assert control_characters("".join(row), allowed="") == set()
    assert len(aligned([[text, text], ["a", "b"]]).split("\n")) == 2
    assert "\n" not in lines([text])
    assert "\n" not in paragraph(f"a {text[:20]} b")


def test_console_and_plain_mode_replace_control_characters(capsys):
    ConsoleListener().report(f"one {HOSTILE}")
    Terminal().say(f"one\ntwo {HOSTILE}")
    captured = capsys.readouterr()
    assert control_characters(captured.out + captured.err) == set()
    assert captured.err.count("\n") == 1
    assert captured.out.count("\n") == 2


def test_error_messages_repeat_arguments_as_text(tmp_path, capsys, run_command):
    name = str(tmp_path / "no\x1b[31msuch\nsarcal: all is well\u202e")
    for arguments in (
        ["solve", name, *SARCOS_HINGE],
        ["run", name],
        ["report", name],
        ["compare", name, name],
        ["session", "show", name],
        ["run", "--unsensed", name],
    ):
        message = run_command(2, *arguments).err
        assert control_characters(message) == set()
        assert not any(line.startswith("sarcal: all is well") for line in message.splitlines())
    with pytest.raises(SystemExit):
        main(["run", f"--{HOSTILE}"])
    assert control_characters(capsys.readouterr().err) == set()


@pytest.fixture
def write_outlier_poses(reference_data, tmp_path):
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


def test_pose_labels_are_kept_and_shown_as_text(write_outlier_poses, run_command):
    path = write_outlier_poses(HOSTILE.replace("\ud800", "").replace("\x00", ""))
    assert "\x1b[2J" in load_poses(path, joint_count=7).poses.label[0]
    answer = run_command(4, "solve", path, *SARCOS_HINGE)
    assert "owned" in answer.out, "the outlier is reported by its label"
    assert control_characters(answer.out + answer.err) == set()


def hostile_session(folder: Path) -> Path:
    journal = events()
    for name, data in journal:
        if name == "connected":
            data["serial_number"] = HOSTILE
            data["nodes"][0]["device_name"] = HOSTILE
        if "note" in data or name == "pose_noted":
            data["text" if name == "pose_noted" else "note"] = HOSTILE
    return write_journal(folder, written(journal))


def test_session_texts_are_kept_and_shown_as_text(tmp_path, run_command):
    folder = hostile_session(tmp_path / "one")
    root = ["--sessions", str(tmp_path)]
    assert read_session(folder).state.serial_number == HOSTILE
    listed = run_command(0, "session", "list", *root).out
    assert len(listed.splitlines()) == 2
    shown = run_command(0, "session", "show", "one", *root).out
    assert "owned" in listed + shown
    assert control_characters(listed + shown) == set()
    json_text = run_command(0, "session", "show", "one", "--json", *root).out
    assert control_characters(json_text) == set()
    assert json.loads(json_text)["serial_number"] == HOSTILE


def stream_on_full_disk() -> TextIO:
    return Path("/dev/full").open("w", encoding="utf-8", buffering=1)


def stream_without_reader() -> TextIO:
    reader, writer = os.pipe()
    os.close(reader)
    return os.fdopen(writer, "w", buffering=1, encoding="utf-8")


@pytest.mark.parametrize("stream", [stream_on_full_disk, stream_without_reader])
def test_unwritable_progress_is_ignored(monkeypatch, stream):
    """A calibration must not end because of it."""
    with stream() as broken:
        monkeypatch.setattr("sys.stderr", broken)
        for _ in range(3):
            ConsoleListener().report("one line of progress")
            say("another", err=True)


@pytest.mark.parametrize(
    ("stream", "words", "code"),
    [
        # 4: not accepted, because of the outlier. 2: the output was to be kept, and could not be written.
        (stream_without_reader, ["solve", "poses.csv", *SARCOS_HINGE], 4),
        (stream_on_full_disk, ["solve", "poses.csv", *SARCOS_HINGE], 2),
        (stream_on_full_disk, ["--help"], 2),
    ],
)
def test_exit_code_with_unwritable_results(write_outlier_poses, monkeypatch, stream, words, code):
    monkeypatch.chdir(write_outlier_poses("").parent)
    with stream() as broken:
        monkeypatch.setattr("sys.stdout", broken)
        assert main(words) == code


def test_streaming_ends_when_its_reader_closes(monkeypatch):
    with stream_without_reader() as broken:
        monkeypatch.setattr("sys.stdout", broken)
        with pytest.raises(BrokenPipeError):
            say("what was seen", streaming=True)


@pytest.mark.sample(2)
@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", ">&- 2>&-"])
def test_closed_streams_are_no_error(closed, tmp_path):
    command = f"{sys.executable} -m operator_app.cli session list --sessions {tmp_path} {closed}"
    process = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert process.returncode == 0
    assert "Traceback" not in process.stdout + process.stderr

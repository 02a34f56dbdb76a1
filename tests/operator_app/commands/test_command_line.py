"""Command line conventions: suggestions, usage, completion, tables, files for other tools."""

import os
import subprocess
import sys
from pathlib import Path

import canopen
import pytest

from operator_app.cli import COMMANDS
from operator_app.commands.table import APP, parser_of

HINGE = Path(__file__).parents[2] / "data/hinge/hinge_exact.csv"


def test_unknown_command_gets_a_suggestion_or_the_list(run_command):
    for misspelt, suggestion in (
        ("runn", "run"),
        ("sovle", "solve"),
        ("exprot", "export"),
        ("upload", "export SESSION --upload"),
    ):
        assert f"did you mean {suggestion}?" in run_command(2, misspelt, "hinge").err
    message = run_command(2, "xyzzy\x1b[2J").err
    assert "did you mean" not in message
    assert all(command in message for command in COMMANDS)
    assert "\x1b" not in message


def test_options_are_accepted_at_any_position(tmp_path, monkeypatch, run_command):
    monkeypatch.chdir(tmp_path)
    for command in (
        "session show --json none_such",
        "session --json show none_such",
        "verify none_such --json poses.csv",
        "run --json none_such",
        "help -- none_such",
    ):
        assert "none_such" in run_command(2, *command.split()).err


def test_unknown_argument_shows_the_usage_of_its_command(run_command):
    message = run_command(2, "session", "list", "one", "more").err
    assert message.startswith("usage: sarcal session")
    assert "unrecognized arguments: more" in message


def test_dumb_terminal_is_referred_to_plain_mode(monkeypatch, run_command):
    """A line-buffered terminal, such as an editor's shell, does not deliver the STOP key."""
    monkeypatch.setenv("TERM", "dumb")
    message = run_command(2).err
    assert "TERM=dumb" in message
    assert "--plain" in message


def test_every_command_with_a_bus_can_record_it():
    options = {
        command: {word for action in parser_of(command)._actions for word in action.option_strings}
        for command in (*COMMANDS, APP)
    }
    with_bus = {command for command, words in options.items() if "--interface" in words}
    assert with_bus == {
        "app", "arm-check", "controller", "export", "monitor", "probe", "reset", "run", "verify",
    }  # fmt: skip
    assert {command for command, words in options.items() if "--record" in words} == with_bus


def test_eds_files_are_readable_by_canopen(tmp_path, run_command):
    run_command(0, "eds", "-o", tmp_path / "eds")
    assert {p.name for p in (tmp_path / "eds").iterdir()} == {"joint.eds", "supervisor.eds"}
    for file in (tmp_path / "eds").iterdir():
        assert canopen.import_od(str(file), node_id=3)[0x1018][1].default is not None
    run_command(0, "eds", "-o", tmp_path / "eds")
    (tmp_path / "eds/joint.eds").write_text("mine")
    run_command(2, "eds", "-o", tmp_path / "eds")
    assert (tmp_path / "eds/joint.eds").read_text() == "mine"


def completions(line: str, folder: Path) -> list[str]:
    """Completions by argcomplete's protocol, answered in a file."""
    answer_file = folder / "answer"
    subprocess.run(
        [sys.executable, "-c", "from operator_app.cli import main; main()"],
        cwd=folder,
        env=os.environ
        | {
            "PYTHONPATH": str(Path(__file__).parents[3]),
            "_ARGCOMPLETE": "1",
            "_ARGCOMPLETE_STDOUT_FILENAME": str(answer_file),
            "_ARGCOMPLETE_IFS": "\n",
            "COMP_LINE": line,
            "COMP_POINT": str(len(line)),
        },
        check=False,
        timeout=240,
    )
    return [word.strip() for word in answer_file.read_text().split("\n")]


def test_shell_completes_commands_options_and_names(tmp_path):
    pytest.importorskip("argcomplete")
    (tmp_path / "sessions/20260101-hinge").mkdir(parents=True)
    assert set(completions("sarcal re", tmp_path)) == {"report", "reproduce", "reset"}
    assert "--drop-unidentifiable" in completions("sarcal import --dr", tmp_path)
    assert completions("sarcal solve p.csv --arm franka_p", tmp_path) == ["franka_panda"]
    assert "hinge_planned" in completions("sarcal run h", tmp_path)
    assert "20260101-hinge" in completions("sarcal report 2", tmp_path)
    assert "arm-file" in completions("sarcal help arm", tmp_path)
    arms = completions("sarcal new arm --from ", tmp_path)
    assert {"franka_panda", "sarcos_dextrous", "ur5e"} <= set(arms)


def test_session_show_prints_a_table(tmp_path, run_command):
    root = ["--sessions", str(tmp_path / "sessions")]
    run_command(0, "import", HINGE, "--serial", "SDA-9", *root)
    output = run_command(0, "session", "show", *root).out
    lines = {" ".join(line.split()) for line in output.splitlines()}
    assert "arm, serial number SDA-9" in lines
    assert f"poses read from {HINGE}" in lines
    assert "poses 60 poses that count" in lines
    assert "exported nothing that its journal records" in lines
    (solved,) = (line for line in lines if line.startswith("solved"))
    assert solved.startswith("solved accepted by implicit, scaled condition number")
    assert "pose j1 j2 j3 j4 j5 j6 j7 sd note" in lines
    first = next(line for line in output.splitlines() if line.split()[:1] == ["1"])
    assert len(first.split()) == 9
    assert max(len(line) for line in output.split("Poses:")[1].splitlines()) <= 80

"""Command line conventions: suggestions, usage, completion, tables; invalid arguments, which write nothing."""

import os
import subprocess
import sys
from pathlib import Path

import canopen
import pytest

from operator_app.cli import COMMANDS
from operator_app.commands.table import APP, parser_of
from operator_app.config.resources import resolve

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
    assert "exported nothing recorded in its journal" in lines
    (solved,) = (line for line in lines if line.startswith("solved"))
    assert solved.startswith("solved accepted by implicit, scaled condition number")
    assert "pose j1 j2 j3 j4 j5 j6 j7 sd note" in lines
    first = next(line for line in output.splitlines() if line.split()[:1] == ["1"])
    assert len(first.split()) == 9
    assert max(len(line) for line in output.split("Poses:")[1].splitlines()) <= 80


SARCOS_HINGE = "--arm sarcos_dextrous --fixture hinge"
CASES = [
    ("run hinge --poses 1e30", "1e30 is not a whole number"),
    ("run hinge --poses 1" + "0" * 30, "from 1 to 100000"),
    pytest.param("run --poses " + "9" * 5000, "from 1 to 100000", id="poses of 5000 digits"),
    ("plan hinge --poses 1000000", "from 1 to 100000"),
    ("run hinge --poses 0", "from 1 to 100000"),
    ("run hinge -i loopback -c a\x1bb", "printable"),
    pytest.param("run hinge -i loopback -c " + "a" * 300, "255", id="long channel"),
    ("run hinge -i socketcan -c \udcff", "printable"),
    ("run hinge -i nonsense", "Use one of"),
    ("probe -i socketcan", "-i socketcan -c can0"),
    ("session list nonsense", "sarcal session show nonsense"),
    ("plan hinge --arm UR5e", "did you mean ur5e?"),
    ("help --files x", "name a page that shows files"),
    ("run ~nosuchuser/x", "~nosuchuser/x: there is no such file"),
    (f"solve ~nosuchuser/x {SARCOS_HINGE}", "there is no such file"),
    ("report ~nosuchuser/x", "'~nosuchuser/x' is not a session"),
    ("compare ~nosuchuser/x y", "'~nosuchuser/x' is no"),
    ("run --sessions ~nosuchuser/x", "no such home folder"),
    ("export x -o ~nosuchuser/x", "no such home folder"),
    ("probe --record ~nosuchuser/x", "no such home folder"),
    ("probe --configure", "--draft FILE"),
    pytest.param(f"import {'a' * 5000} --deg {SARCOS_HINGE}", "name too long", id="long file name"),
    *(
        pytest.param(command.replace("LONG", "a" * 5000), message, id=command)
        for command, message in (
            ("compare LONG LONG", "is not a session"),
            ("eds -o LONG", "File name too long): name another folder"),
            ("help own-arm --files LONG", "File name too long): name another folder"),
            (f"import LONG.mcap {SARCOS_HINGE}", "there is no such file"),
        )
    ),
    (f"solve pipe {SARCOS_HINGE}", "it is a pipe, not a file"),
    ("plan --arm ./pipe --fixture hinge", "a pipe"),
    ("run ./pipe", "it is a pipe, not a file"),
    ("run --sessions pipe", "cannot write"),
    ("session list --sessions file", "cannot read"),
    ("run ./slow", "speed_deg_per_s: must be at least 0.05"),
    ("--speed 1e-300 --plain", "between 0.01 and 50"),
    ("run --length-tolerance -1", "-1 is not a number between 0 and 100 mm"),
    ("run hinge_planned --placements 2", "one placement"),
    ("run open_loop --placements 2", "no fixture to remount"),
    ("run hinge --placements 21", "Request 1 to 20"),
    ("run hinge --placements 0", "not a whole number"),
    ("reproduce --poses 7", "from 8 to 120"),
    ("reproduce --poses 121", "from 8 to 120"),
    ("verify latest", "no session"),
    ("reset", "nothing to reset"),
]
REFUSED = [
    "run nowhere.yaml",
    "run hing",
    "run hinge --poses 2",
    "run hinge --unsensed 8",
    "run --resume nowhere",
    "run hinge --seed -1",
    "plan hing",
    "plan hinge --poses 0",
    "plan hinge --poses 50000",
    "plan hinge --arm nowhere.yaml",
    "plan hinge --fixture hing",
    "plan hinge --fixture rigid",
    "plan hinge --fixture ball",
    "plan hinge --unsensed 9",
    "plan hinge --advise --tries 0",
    "plan hinge --tries 3",
    "run hinge --tracker tcp:127.0.0.1:7327",
    "plan --session nowhere",
    "plan hinge --session latest",
    "solve missing.csv",
    "solve missing.csv --arm sarcos",
    "solve missing.csv --fixture hing",
    "solve missing.csv --unsensed six",
    "solve missing.csv --unsensed 9",
    "solve missing.csv --unsensed 0",
    "solve missing.csv --unsensed ,",
    "solve missing.csv --unsensed 6 --estimator paper",
    pytest.param(f"solve missing.csv --unsensed {'1' * 5000}", id="joint of 5000 digits"),
]
"""Refusals of which the whole text is approved."""


@pytest.fixture
def refuse(tmp_path, run_command, monkeypatch):
    """Return the error of a command that is refused and writes nothing into its folder."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    (tmp_path / "file").write_text("x")
    procedure = resolve("procedure", "hinge").data.decode()
    speed = next(line for line in procedure.splitlines() if "speed_deg_per_s" in line)
    (tmp_path / "slow").write_text(procedure.replace(speed, "  speed_deg_per_s: 1.0e-300"))
    before = sorted(tmp_path.rglob("*"))

    def run(command: str) -> str:
        answer = run_command(2, *command.split())
        assert answer.out == ""
        assert sorted(tmp_path.rglob("*")) == before
        return answer.err

    return run


@pytest.mark.parametrize(("command", "message"), CASES)
def test_invalid_argument_is_one_error_and_nothing_is_written(refuse, command, message):
    assert message in refuse(command)


@pytest.mark.parametrize("command", REFUSED)
def test_refusal_is_approved_and_nothing_is_written(refuse, command, approve):
    approve(refuse(command))


ARGUMENTS = [
    (command, action)
    for command in (APP, *COMMANDS)
    for action in parser_of(command)._actions
    if action.nargs != 0
]
"""Every option and positional argument, of every command, that takes a value."""


@pytest.mark.sample(90)
@pytest.mark.parametrize("blank", ["", " \t"])
@pytest.mark.parametrize(
    ("command", "action"),
    ARGUMENTS,
    ids=[f"{c} {a.option_strings or a.dest}" for c, a in ARGUMENTS],
)
def test_empty_value_is_refused_before_anything_is_opened(
    command, action, blank, tmp_path, run_command, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    required = {"session name": ["list"], "verify csv": ["x"], "compare b": ["x"]}
    before = required.get(f"{command} {action.dest}", [])
    name = "/".join(action.option_strings) or action.metavar or action.dest
    words = [*([] if command == APP else [command]), *before, *action.option_strings[-1:], blank]
    answer = run_command(2, *words)
    assert f"error: argument {name}: " in answer.err
    assert answer.out == ""
    assert not list(tmp_path.iterdir())

"""Arguments that no command can use: one error, exit code 2, and nothing written."""

import os

import pytest

from operator_app.commands.table import APP, COMMANDS, parser_of
from operator_app.config.resources import resolve

SARCOS_HINGE = "--arm sarcos_dextrous --fixture hinge"
CASES = [
    ("run hinge --poses 1e30", "1e30 is not a whole number"),
    ("run hinge --poses 1" + "0" * 30, "up to 100000"),
    pytest.param("run --poses " + "9" * 5000, "up to 100000", id="poses of 5000 digits"),
    ("plan hinge --poses 1000000", "up to 100000"),
    ("run hinge --poses 0", "Request at least 1"),
    ("run hinge -i loopback -c a\x1bb", "printable"),
    pytest.param("run hinge -i loopback -c " + "a" * 300, "255", id="long channel"),
    ("run hinge -i socketcan -c \udcff", "printable"),
    ("run hinge -i nonsense", "Use one of"),
    ("probe -i socketcan", "No channel is given"),
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
    (f"solve pipe {SARCOS_HINGE}", "it is a pipe, not a file"),
    ("plan --arm ./pipe --fixture hinge", "a pipe"),
    ("run ./pipe", "it is a pipe, not a file"),
    ("run --sessions pipe", "cannot write"),
    ("session list --sessions file", "cannot read"),
    ("run ./slow", "speed_deg_per_s: must be at least 0.05"),
    ("--speed 1e-300 --plain", "between 0.01 and 50"),
    ("run --length-tolerance -1", "more than 0 and at most 100"),
    ("run hinge_planned --placements 2", "one placement"),
    ("run open_loop --placements 2", "no fixture to remount"),
    ("run hinge --placements 21", "Request 1 to 20"),
    ("run hinge --placements 0", "not a whole number"),
    ("reproduce --poses 7", "between 8 and 120"),
    ("reproduce --poses 121", "between 8 and 120"),
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

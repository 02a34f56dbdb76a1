"""Input that no command can use: one clear error, exit 2, and nothing written."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from operator_app.commands.table import APP, COMMANDS, parser_of
from operator_app.config.resources import resolve

PROCEDURE = resolve("procedure", "hinge").data.decode()
SPEED = next(line for line in PROCEDURE.splitlines() if "speed_deg_per_s" in line)


def slow(folder: Path) -> str:
    path = folder / "slow.yaml"
    path.write_text(PROCEDURE.replace(SPEED, "  speed_deg_per_s: 1.0e-300"))
    return str(path)


def pipe(folder: Path) -> str:
    path = folder / "pipe"
    os.mkfifo(path)
    return str(path)


ARM = ("--arm", "sarcos_dextrous", "--fixture", "hinge")
CASES: dict[str, tuple[Callable[[Path], list[str]], str]] = {
    "poses 1e30": (lambda _: ["run", "hinge", "--poses", "1e30"], "1e30 is not a whole number"),
    "poses 10^30": (lambda _: ["run", "hinge", "--poses", "1" + "0" * 30], "up to 100000"),
    "poses of 5000 digits": (lambda _: ["run", "--poses", "9" * 5000], "up to 100000"),
    "poses to plan": (lambda _: ["plan", "hinge", "--poses", "1000000"], "up to 100000"),
    "no pose": (lambda _: ["run", "hinge", "--poses", "0"], "Request at least 1"),
    "channel": (lambda _: ["run", "hinge", "-i", "loopback", "-c", "a\x1bb"], "printable"),
    "long channel": (lambda _: ["run", "hinge", "-i", "loopback", "-c", "a" * 300], "255"),
    "half a channel": (lambda _: ["run", "hinge", "-i", "socketcan", "-c", "\udcff"], "printable"),
    "no interface": (lambda _: ["run", "hinge", "-i", "nonsense"], "Use one of"),
    "no channel": (lambda _: ["probe", "-i", "socketcan"], "No channel is given"),
    "files of no page": (lambda _: ["help", "--files", "x"], "name a page that shows files"),
    "nobody's home": (lambda _: ["run", "~nosuchuser/x"], "~nosuchuser/x: there is no such file"),
    "nobody's poses": (lambda _: ["solve", "~nosuchuser/x", *ARM], "there is no such file"),
    "nobody's session": (lambda _: ["report", "~nosuchuser/x"], "'~nosuchuser/x' is not a session"),
    "nobody's parameters": (lambda _: ["compare", "~nosuchuser/x", "y"], "'~nosuchuser/x' is no"),
    "nobody's sessions": (lambda _: ["run", "--sessions", "~nosuchuser/x"], "no such home folder"),
    "nobody's export": (lambda _: ["export", "x", "-o", "~nosuchuser/x"], "no such home folder"),
    "nobody's recording": (lambda _: ["probe", "--record", "~nosuchuser/x"], "no such home folder"),
    "nothing to configure in": (lambda _: ["probe", "--configure"], "--draft FILE"),
    "a pipe for poses": (lambda p: ["solve", pipe(p), *ARM], "it is a pipe, not a file"),
    "a pipe for an arm": (lambda p: ["plan", "--arm", pipe(p), "--fixture", "hinge"], "a pipe"),
    "a pipe for a procedure": (lambda p: ["run", pipe(p)], "it is a pipe, not a file"),
    "a pipe for sessions": (lambda p: ["run", "--sessions", pipe(p)], "cannot write"),
    "a file for sessions": (
        lambda p: ["session", "list", "--sessions", str((p / "f").write_text("x") and p / "f")],
        "cannot read",
    ),
    "a speed of nothing": (lambda p: ["run", slow(p)], "speed_deg_per_s: must be at least 0.05"),
    "an arm of no speed": (lambda _: ["--speed", "1e-300", "--plain"], "between 0.01 and 50"),
    "tolerance": (lambda _: ["run", "--length-tolerance", "-1"], "more than 0 and at most 100"),
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_one_error_and_nothing_is_written(tmp_path, case, ends_with, monkeypatch):
    words, expected = CASES[case]
    argv = words(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    said = ends_with(2, *argv)
    assert expected in said.err
    assert said.out == ""
    assert sorted(tmp_path.rglob("*")) == before


VALUES = [
    (command, action)
    for command in (APP, *COMMANDS)
    for action in parser_of(command)._actions
    if action.nargs != 0
]
"""Every option and every positional argument, of every command, that takes a value."""


@pytest.mark.sample(90)
@pytest.mark.parametrize("blank", ["", " \t"])
@pytest.mark.parametrize(
    ("command", "action"), VALUES, ids=[f"{c} {a.option_strings or a.dest}" for c, a in VALUES]
)
def test_an_empty_value_is_refused_before_anything_is_opened(
    command, action, blank, tmp_path, ends_with, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    first = {"session name": ["list"], "verify csv": ["x"], "compare b": ["x"]}
    before = first.get(f"{command} {action.dest}", [])
    words = [*([] if command == APP else [command]), *before, *action.option_strings[-1:], blank]
    said = ends_with(2, *words)
    name = "/".join(action.option_strings) or action.metavar or action.dest
    assert f"error: argument {name}: " in said.err
    assert said.out == ""
    assert not list(tmp_path.iterdir())

"""Fuzzing of the command line."""

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path
from random import Random

from operator_app.cli import COMMANDS, main
from tests.oracles.document_fuzzing import DATA
from tests.oracles.input_mutations import Refused

ODD_WORDS = (
    "", "-", "--", "-1", "0", "nan", "inf", "1e999", "1e-300", "9" * 40, "\u0663", "\x1b[2J", "a" * 5000,
    "~nosuchuser/x", "/dev/null", "/dev/full", "/proc/self/mem", ".", "..", "/", "\udcff", "x\x00y", "6,7",
    "1,,2", "latest", "hinge", "sarcos_dextrous", "no.csv", "--json", "-c", "{}", "%s", "virtual", "vcan0",
)  # fmt: skip
ENDLESS = ("run", "plan", "controller", "monitor", "probe")
"""Commands that might not end by themselves: they are given an unknown option in addition."""
TAKES_SESSIONS = ("export", "report", "compare", "run", "session", "import")
ARGUMENTS: Mapping[str, tuple[str, ...]] = {
    "solve": (str(DATA), "--arm", "--fixture", "--estimator", "paper", "--unsensed", "--global-start",
              "--length-tolerance", "--rvdt-table", "--json"),
    "verify": (str(DATA), "--poses", "--arm", "--fixture", "--session", "--open-loop", "--json"),
    "export": ("--upload", "--force", "--show", "--output", "--json"),
    "report": ("--output", "--json", "-o"),
    "compare": ("--json", "--remounted"),
    "session": ("list", "show", "repair", "--json"),
    "reset": ("--json", "-i", "-b", "--scenario"),
    "import": (str(DATA), "--rad", "--deg", "--columns", "1-7", "--arm", "--fixture", "--serial", "--json"),
    "new": ("arm", "fixture", "procedure", "--urdf", "--tip", "--name", "--from", "--kind", "--arm", "--fixture",
            "--hand-point", "--base-point", "--hand-direction", "--tolerance-mm", "ball", "1,2,3", str(DATA)),
    "check": (str(DATA), "--arm", "--fixture", "--procedure", "--json", "README.md"),
    "run": ("--poses", "--tracker", "--resume", "--force", "--plan", "--estimator", "--unsensed", "-i", "-b", "--seed"),
    "plan": ("--poses", "--fixture", "--arm", "--seed", "--joints", "--json"),
    "controller": ("--arm", "--state", "--fault", "--fault-joint", "--fault-sync", "-i", "-c", "--seed"),
    "monitor": ("-i", "-c", "-b"),
    "probe": ("-i", "-c", "-b", "--json", "--profile", "--draft"),
}  # fmt: skip


def fuzz_command(rng: Random, folder: Path) -> None:
    """Run a random command line: it ends with a documented exit code and prints no escape sequence."""
    command = rng.choice(tuple(ARGUMENTS))
    arguments = ARGUMENTS[command]
    words = [command, *(rng.choice(arguments + ODD_WORDS) for _ in range(rng.randrange(6)))]
    if rng.random() < 0.5:
        words += [rng.choice(arguments), rng.choice(ODD_WORDS)]
    if command in ENDLESS:
        words.append("--no-such-option")
    if rng.random() < 0.2:
        rng.shuffle(words)
        words = words if {*words} & {*COMMANDS} else [command, *words]
    elif command in TAKES_SESSIONS:
        words += ["--sessions", str(folder)]
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        try:
            code = main(words)
        except SystemExit as usage_error:
            code = usage_error.code
    if code not in (0, 2, 3, 4, 5):
        raise AssertionError(f"exit code {code} for {words}")
    if "\x1b[2J" in output.getvalue():
        raise AssertionError(f"escape sequence in the output of {words}")
    if code != 0:
        raise Refused(output.getvalue())

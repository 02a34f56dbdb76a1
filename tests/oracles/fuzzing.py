"""Fuzzing of every parser and of the bus: valid inputs with random mutations, by seed.

An input is accepted, or refused with an expected error; any other exception is a defect and is raised.
"""

import contextlib
import functools
import io
import re
from collections.abc import Mapping
from pathlib import Path
from random import Random

from hardware.line_port import CalledLines, GrowingFile, LinePort
from operator_app.cli import COMMANDS, main
from operator_app.exit_codes import EXPECTED_ERRORS
from operator_app.session.workflow.pose_reading import Instrument
from tests.oracles.bus_fuzzing import FuzzedOperator
from tests.oracles.document_fuzzing import DATA, DOCUMENTS, Parser, Refused, bytes_changed

ODD_WORDS = (
    "", "-", "--", "-1", "0", "nan", "inf", "1e999", "1e-300", "9" * 40, "\u0663", "\x1b[2J", "a" * 5000,
    "~nosuchuser/x", "/dev/null", "/dev/full", "/proc/self/mem", ".", "..", "/", "\udcff", "x\x00y", "6,7",
    "1,,2", "latest", "hinge", "sarcos_dextrous", "no.csv", "--json", "-c", "{}", "%s", "virtual", "vcan0",
)  # fmt: skip
NOT_RUN = ("run", "plan", "controller", "monitor", "probe", "reproduce", "eds")
"""Commands that might not end by themselves, or write where they are told: they get an unknown option in addition."""
POSITIONAL = (
    str(DATA), "list", "show", "repair", "arm", "fixture", "procedure", "ball", "1,2,3", "1-7", "paper", "README.md",
)  # fmt: skip


@functools.cache
def options(command: str) -> tuple[str, ...]:
    """Every option that a command's help names, except the help itself."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.suppress(SystemExit):
        main([command, "--help"])
    named = {*re.findall(r"(?<![\w-])--?[a-z][a-z-]*", output.getvalue())}
    return tuple(sorted(named - {"-h", "--help"}))


def fuzz_command(rng: Random, folder: Path) -> None:
    """Run a random command line: it ends with a documented exit code and prints no escape sequence."""
    command = rng.choice(tuple(COMMANDS))
    arguments = options(command) + POSITIONAL
    words = [command, *(rng.choice(arguments + ODD_WORDS) for _ in range(rng.randrange(6)))]
    if rng.random() < 0.5:
        words += [rng.choice(arguments), rng.choice(ODD_WORDS)]
    if command in NOT_RUN:
        words.append("--no-such-option")
    if rng.random() < 0.2:
        rng.shuffle(words)
        words = words if {*words} & {*COMMANDS} else [command, *words]
    elif "--sessions" in options(command):
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


REPLIES = (
    b'{"pose": "12", "x_m": 0.1, "y_m": 0.2, "z_m": 0.3, "rx_deg": 1, "ry_deg": 2, "rz_deg": 3}',
    b'{"pose": "12", "lost": "behind the elbow"}',
    b'{"x_m": 0.1, "y_m": 0.2, "z_m": 0.3, "qw": 1, "qx": 0, "qy": 0, "qz": 0}',
)
HEADING, ROW = b"pose,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n", b"12,0.1,0.2,0.3,1,2,3\n"


def fuzz_instrument(rng: Random, folder: Path) -> None:
    """Read a JSON reply, or a growing file with a fuzzed heading or row."""
    port: LinePort
    if rng.random() < 0.5:
        reply = bytes_changed(rng.choice(REPLIES), rng).decode(errors="replace")
        port = CalledLines(lambda _: reply, "a tracker")
    else:
        file = folder / "rows.csv"
        file.write_bytes(bytes_changed(HEADING, rng) if rng.random() < 0.5 else HEADING)
        port = _AppendedFile(file, bytes_changed(ROW, rng))
    instrument = Instrument(port, full_pose=rng.random() < 0.5, patience_s=0.0)
    instrument.open()
    instrument.measure("12")


class _AppendedFile(GrowingFile):
    """A file that grows by a row at each request."""

    def __init__(self, path: Path, row: bytes) -> None:
        super().__init__(path)
        self._file, self._row = path, row

    def ask(self, question: str) -> None:
        super().ask(question)
        with self._file.open("ab") as file:
            file.write(self._row)


_operator = FuzzedOperator()
over = _operator.close
PARSERS: Mapping[str, Parser] = {
    **DOCUMENTS,
    "arguments": fuzz_command,
    "instrument": fuzz_instrument,
    "the wire": lambda rng, _: _operator.fuzz(rng),
}


def outcome(kind: str, seed: int, folder: Path) -> str:
    rng = Random(f"{kind} {seed}")  # noqa: S311 - to be repeated, not to be secret
    try:
        PARSERS[kind](rng, folder)
    except (*EXPECTED_ERRORS, Refused):
        return "refused"
    return "accepted"

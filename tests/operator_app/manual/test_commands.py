"""Every command and notebook cell of the manual runs, page by page, in a folder with the files that the pages name.

A controller in another process simulates the arm at can0. Slow pages are run in the campaign only.
"""

import ast
import contextlib
import io
import json
import os
import re
import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from operator_app.cli import main
from operator_app.commands.table import APP, COMMANDS, parser_of
from operator_app.manual.pages import FOLDER, NOTEBOOKS
from tests.oracles.open_arm import write_measured_poses
from tests.oracles.own_process import SARCAL, controller
from tests.oracles.panda import panda_readings
from tests.oracles.pty_program import PtyProgram
from tests.oracles.recorded import cached_folder
from tests.oracles.recordings import recorded_arm, write_bag, write_log

DATA = Path(__file__).parents[2] / "data"
HINGE, PANDA = DATA / "hinge/hinge_exact.csv", DATA / "panda_ball/panda_1.csv"
CAN_OPTIONS = "-i socketcan -c can0"
TIMEOUT_S = 240.0
REDIRECTED = re.compile(r" > (\S+)$")

BLOCK = re.compile(r"((?:<!--[^\n]*-->\n)*)```(\w+)\n(.*?)```", re.DOTALL)
MARK = re.compile(r"<!-- (run|file): (.*?) -->")
OTHER_PROGRAMS = (
    "python3 -m venv ", ".venv/bin/pip ", "source ", "sudo ip link ", "pip install ", "eval ",
    "python ", "CAN_INTERFACE=",
)  # fmt: skip
"""Prefixes of the pages' commands of other programs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A block of code of a page: its language, and the page's comment on how to run it."""

    language: str
    text: str
    run: str
    file: str

    @property
    def commands(self) -> list[str]:
        return self.text.replace("\\\n", " ").splitlines() if self.language == "sh" else []


def page_topics() -> list[str]:
    return sorted(f.name[:-3] for f in FOLDER.iterdir() if f.name.endswith(".md"))


def blocks(topic: str) -> list[Block]:
    page_blocks = []
    for comments, language, text in BLOCK.findall((FOLDER / f"{topic}.md").read_text()):
        marks = {"run": "", "file": "", **dict(MARK.findall(comments))}
        page_blocks.append(Block(language=language, text=text, **marks))
    return page_blocks


TOPICS_WITH_COMMANDS = [topic for topic in page_topics() if any(b.commands for b in blocks(topic))]
SLOW_TOPICS = (
    "mounting", "outside-arm", "own-arm", "own-hinge", "own-poses", "paper", "planned-poses", "real-can",
    "recording", "recordings", "scripting", "simulated", "still-valid", "tutorial", "wrist-repair",
)  # fmt: skip
"""Pages that take more than three seconds."""
TOPICS_WITHOUT_SESSION = ("paper", "scripting", "still-valid", "tutorial", "wrist-repair")
"""Pages that create their session themselves."""


@pytest.fixture(scope="module")
def prepared():
    """A folder with a session and the files that pages call my_*; read-only."""
    return cached_folder(prepare)


def prepare(folder: Path) -> None:
    rows = HINGE.read_text().splitlines()
    (folder / "my_poses.csv").write_text("\n".join(rows[:25]) + "\n")
    (folder / "my_other_poses.csv").write_text("\n".join([rows[0], *rows[25:45]]) + "\n")
    angles = [[float(cell) for cell in row.split(",")[2:9]] for row in rows[1:25]]
    np.savetxt(folder / "my_log.csv", np.deg2rad(angles), delimiter=",")
    sockets, q_rad = panda_readings()
    rows_of_sockets = [
        f"hole {k},{','.join(map(repr, q.tolist()))}" for k, q in zip(sockets, q_rad, strict=True)
    ]
    head = "socket," + ",".join(f"q{j}" for j in range(1, 8))
    (folder / "my_long_log.csv").write_text("\n".join([head, *rows_of_sockets[:60]]) + "\n")
    for k in (1, 2):
        q_of_socket = [q for placement, q in zip(sockets, q_rad, strict=True) if placement == k]
        np.savetxt(folder / f"socket_{k}.csv", q_of_socket, delimiter=",")
    first_sockets = [row for row in PANDA.read_text().splitlines() if row[0] in "p1234"]
    (folder / "my_sockets.csv").write_text("\n".join(first_sockets) + "\n")
    write_measured_poses(folder / "open_arm.csv")
    names = [f"panda_joint{j}" for j in range(1, 8)]
    for k, storage, bag, log in (
        (1, "mcap", "my_run.mcap", "my_recording.csv"),
        (2, "sqlite3", "my_run_2.db3", "my_recording_2.csv"),
    ):
        run = recorded_arm(q_rad[sockets == k], decoys=5, seed=k)
        write_bag(folder / f"run_{k}", *run, names, storage=storage, seed=k).rename(folder / bag)
        write_log(folder / log, *run, names)
    with contextlib.chdir(folder):
        assert run_line("sarcal run hinge --scenario exact --poses 10") == 0
        assert run_line("sarcal export latest --format urdf -o my_arm.urdf") == 0


@pytest.fixture
def working_folder(prepared, tmp_path, monkeypatch):
    """The current folder, with all files that pages name or show."""
    for file in prepared.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    for topic in page_topics():
        for block in blocks(topic):
            if block.file:
                (tmp_path / block.file).write_text(block.text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path


def run_line(command: str, bus: str = "") -> int:
    """Run a command line, with its output redirected to a file if the line says so."""
    redirected = REDIRECTED.search(command)
    line = REDIRECTED.sub("", command).replace(CAN_OPTIONS, bus)
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        code = main(shlex.split(line)[1:])
    if redirected:
        Path(redirected[1]).write_text(output.getvalue())
    return code


def sarcal_commands(block: Block) -> list[str]:
    return [c for c in block.commands if c.strip() and not c.startswith(OTHER_PROGRAMS)]


def start_and_quit(folder: Path) -> int:
    """Start the app in a pseudo-terminal, wait for its first screen, and press q."""
    program = PtyProgram(SARCAL, size=(120, 36), folder=folder)
    try:
        program.seen("Connect", 0)
        program.write(b"q")
        return program.process.wait(TIMEOUT_S)
    finally:
        program.close()


@pytest.mark.parametrize(
    "topic",
    [
        pytest.param(t, marks=[pytest.mark.campaign] if t in SLOW_TOPICS else [])
        for t in TOPICS_WITH_COMMANDS
    ],
)
def test_commands_of_a_page_run_from_top_to_bottom(topic, prepared, working_folder):
    if topic not in TOPICS_WITHOUT_SESSION:
        shutil.copytree(prepared / "sessions", "sessions")
    with contextlib.ExitStack() as stack:
        bus = ""

        def start_controller(*options: str) -> str:
            bus = f"-i loopback -c manual-{os.getpid()}"
            stack.enter_context(controller(working_folder, *bus.split(), *options))
            return bus

        for block in blocks(topic):
            if block.run in ("terminal", "toy"):
                continue
            for command in sarcal_commands(block):
                if block.run == "background":
                    options = shlex.split(command)[2:]
                    bus = start_controller(*options[2:])
                    continue
                if CAN_OPTIONS in command and not bus:
                    bus = start_controller()
                if command == "sarcal":
                    assert start_and_quit(working_folder) == 0
                    continue
                # The verdict is open for an arm whose errors exceed its files.
                exit_codes = (0, 4) if block.run == "verdict" else (0,)
                line = command.replace("-i loopback", CAN_OPTIONS) if bus else command
                assert run_line(line, bus) in exit_codes, command


@pytest.mark.parametrize(
    "topic",
    [t for t in page_topics() if any(b.language == "python" and not b.file for b in blocks(t))],
)
def test_python_blocks_run(topic, working_folder, capsys):
    for block in blocks(topic):
        if block.language == "python" and not block.file:
            exec(compile(block.text, topic, "exec"), {})  # noqa: S102 - the page
    assert "theta_off_2" in capsys.readouterr().out


def test_every_block_is_of_a_kind_that_tests_run():
    for topic in TOPICS_WITH_COMMANDS:
        for block in blocks(topic):
            assert block.language in ("sh", "yaml", "toml", "python", "text"), topic
            # The toy's are run by tests/system/test_arm_plugin.py.
            assert block.run in ("", "campaign", "verdict", "background", "terminal", "toy"), topic
            for command in filter(str.strip, block.commands):
                assert command.startswith(("sarcal ", *OTHER_PROGRAMS)) or command == "sarcal", (
                    command
                )
            assert block.language != "yaml" or block.file


def test_quoted_commands_have_valid_options():
    """Commands in sentences and tables; those in blocks run."""
    for topic in page_topics():
        prose = re.sub(r"```.*?```", "", (FOLDER / f"{topic}.md").read_text(), flags=re.DOTALL)
        for quoted in re.findall(r"`sarcal(?: ([^`]*))?`", " ".join(prose.split())):
            words = shlex.split(quoted)
            name = words[0] if words and not words[0].startswith("-") else APP
            assert name in {APP, *COMMANDS}, f"{topic}: {quoted}"
            options = {o for a in parser_of(name)._actions for o in a.option_strings}
            unknown = {w for w in words if w.startswith("-")} - options
            assert not unknown, f"{topic}: {quoted}"


NAMES = sorted(f.name for f in NOTEBOOKS.iterdir() if f.name.endswith(".ipynb"))


def run_cell(source: str, names: dict[str, Any]) -> Any:
    """Run a cell and return the value of a final expression, as a notebook shows it."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)  # noqa: S102 - the notebook
    if last is None:
        return None
    assert isinstance(last, ast.Expr)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)  # noqa: S307


@pytest.mark.parametrize("name", NAMES)
def test_cells_run_in_order(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    values = []
    for cell in json.loads((NOTEBOOKS / name).read_text())["cells"]:
        if cell["cell_type"] == "code":
            values.append(run_cell("".join(cell["source"]), names))
    output = capsys.readouterr().out
    match name:
        case "own_readings.ipynb":
            result = names["result"]
            assert result.accepted
            tables = [s._repr_html_() for s in values if hasattr(s, "_repr_html_")]
            assert any("<table" in table for table in tables)
            error = abs(result.values["theta_off_2_deg"] - names["made"].truth["theta_off_2_deg"])
            assert error < 4 * result.sigmas["theta_off_2_deg"]
            assert "theta_off_2_deg" in output
            assert main(["report", "my_calibration", "--text"]) == 0
        case "what_moved.ipynb":
            assert "theta_off_3" in str(names["found"].drifted)
            moved, sigma = (float(n) for n in re.findall(r"-?\d\.\d+", output))
            assert moved == pytest.approx(-0.5, abs=3 * sigma)


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_valid_without_outputs(name):
    """Format 4.5, with unique ids."""
    notebook = json.loads((NOTEBOOKS / name).read_text())
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    for cell in notebook["cells"]:
        assert cell["cell_type"] in ("code", "markdown")
        assert cell.get("outputs", []) == []


def test_help_writes_the_notebooks(tmp_path, run_command):
    run_command(0, "help", "notebooks", "--files", tmp_path / "here")
    assert sorted(p.name for p in (tmp_path / "here").iterdir()) == NAMES

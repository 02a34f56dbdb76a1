"""Every command of the pages runs, from top to bottom of its page, in a folder that has what the page names.

Here a run is short: ten poses of the exact arm, made once and copied. The campaign types the pages as they
are. A controller in another process stands at the end of can0.
"""

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from operator_app.cli import main
from tests.oracles.manual_pages import NOT_OURS, Block, blocks, written_topics
from tests.oracles.open_arm import measured_csv
from tests.oracles.panda import panda_readings
from tests.oracles.pty_program import PtyProgram
from tests.oracles.recorded import recorded_folder
from tests.oracles.recordings import recorded_arm, write_bag, write_log

HINGE = Path(__file__).parents[2] / "data/hinge/hinge_exact.csv"
START = [sys.executable, "-c", "import sys; from operator_app.cli import main; sys.exit(main())"]
RUN = "sarcal run hinge"
SHORT = ["run", "hinge", "--scenario", "exact", "--poses", "10"]
CAN = "-i socketcan -c can0"
PATIENCE_S = 60.0
REDIRECTED = re.compile(r" > (\S+)$")

TOPICS = [topic for topic in written_topics() if any(b.commands for b in blocks(topic))]
LONG = (
    "mounting", "own-poses", "paper", "real-can", "recordings", "scripting", "still-valid", "tutorial",
)  # fmt: skip
"""Pages that take a second or more also where a run is short."""
FROM_NOTHING = ("paper", "scripting", "still-valid", "tutorial", "wrist-repair")
"""Pages that make their session themselves."""


@pytest.fixture(scope="module")
def prepared():
    """A folder with a session and with the files that pages call mine. Not to be changed."""
    return recorded_folder(prepare)


def prepare(folder: Path) -> None:
    """Write the files that pages call mine, and a session."""
    rows = HINGE.read_text().splitlines()
    (folder / "my_poses.csv").write_text("\n".join(rows[:25]) + "\n")
    (folder / "my_other_poses.csv").write_text("\n".join([rows[0], *rows[25:45]]) + "\n")
    angles = [[float(cell) for cell in row.split(",")[2:9]] for row in rows[1:25]]
    np.savetxt(folder / "my_log.csv", np.deg2rad(angles), delimiter=",")
    sockets, q_rad = panda_readings()
    long = [
        f"hole {k},{','.join(map(repr, q.tolist()))}" for k, q in zip(sockets, q_rad, strict=True)
    ]
    head = "socket," + ",".join(f"q{j}" for j in range(1, 8))
    (folder / "my_long_log.csv").write_text("\n".join([head, *long[:60]]) + "\n")
    for k in (1, 2):
        there = [q for placement, q in zip(sockets, q_rad, strict=True) if placement == k]
        np.savetxt(folder / f"socket_{k}.csv", there, delimiter=",")
    names = ["placement", "pose", *(f"theta{j}_deg" for j in range(1, 8))]
    numbered = np.column_stack((sockets, np.arange(1, len(sockets) + 1), np.rad2deg(q_rad)))
    np.savetxt(
        folder / "my_sockets.csv",
        numbered[sockets <= 4],
        "%.12g",
        ",",
        header=",".join(names),
        comments="",
    )
    measured_csv(folder / "open_arm.csv")
    names = [f"panda_joint{j}" for j in range(1, 8)]
    for k, storage, bag, log in (
        (1, "mcap", "my_run.mcap", "my_recording.csv"),
        (2, "sqlite3", "my_run_2.db3", "my_recording_2.csv"),
    ):
        run = recorded_arm(q_rad[sockets == k], decoys=5, seed=k)
        write_bag(folder / f"run_{k}", *run, names, storage=storage, seed=k).rename(folder / bag)
        write_log(folder / log, *run, names)
    with contextlib.chdir(folder):
        assert quietly(SHORT) == 0
        assert quietly(["export", "latest", "--format", "urdf", "-o", "my_arm.urdf"]) == 0


def quietly(words: list[str]) -> int:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return main(words)


@pytest.fixture
def desk(prepared, tmp_path, monkeypatch):
    """The folder of somebody who reads a page."""
    for file in prepared.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    for topic in written_topics():
        for block in blocks(topic):
            if block.file:
                (tmp_path / block.file).write_text(block.text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path


@contextlib.contextmanager
def controller(*options: str) -> Iterator[str]:
    """A virtual controller in a process of its own; how it is reached, in options."""
    bus = f"-i loopback -c manual-{os.getpid()}"
    words = [*START, "controller", *bus.split(), *options]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            assert process.stderr.readline().startswith("Virtual ")
            yield bus
        finally:
            process.kill()


def typed(command: str, bus: str) -> int:
    """Type a line; what it says is kept in a file where the line says so."""
    redirected = REDIRECTED.search(command)
    line = command.replace(CAN, bus)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main(shlex.split(REDIRECTED.sub("", line))[1:])
    if redirected:
        Path(redirected[1]).write_text(said.getvalue())
    return code


def shortened(command: str, prepared: Path, made: list[Path]) -> str:
    """Copy the session that was made once where a run is wanted; return what else is to be typed."""
    if not command.startswith(RUN):
        # New poses come from the arm on which the session was made.
        return command + (" --scenario exact" if "verify latest --poses" in command else "")
    (session,) = (prepared / "sessions").iterdir()
    target = Path("sessions") / f"{session.name}-{len(made)}"
    shutil.copytree(session, target)
    made.append(target)
    rest = command.removeprefix(RUN)
    return f"sarcal report {target}{rest}" if rest else ""


def ours(block: Block) -> list[str]:
    """The commands of a block that are this program's."""
    return [c for c in block.commands if c.strip() and not c.startswith(NOT_OURS)]


def opened_and_left(folder: Path) -> int:
    """Open the app in a terminal of its own, wait until it shows something, and press q."""
    program = PtyProgram(START, size=(120, 36), folder=folder)
    try:
        program.seen("Connect", 0)
        program.write(b"q")
        return program.process.wait(PATIENCE_S)
    finally:
        program.close()


def type_page(topic: str, prepared: Path, desk: Path, *, short: bool) -> None:
    """Type the commands of a page from top to bottom; runs are made short where that is wanted."""
    made: list[Path] = []
    if topic not in FROM_NOTHING:
        shutil.copytree(prepared / "sessions", "sessions")
    with contextlib.ExitStack() as stack:
        bus = ""
        for block in blocks(topic):
            if block.run if short else block.run in ("terminal", "toy"):
                continue
            for command in ours(block):
                if block.run == "background":
                    options = shlex.split(command)[2:]
                    bus = stack.enter_context(controller(*options[2:]))
                    continue
                if CAN in command and not bus:
                    bus = stack.enter_context(controller())
                if command == "sarcal":
                    assert opened_and_left(desk) == 0
                    continue
                line = shortened(command, prepared, made) if short else command
                # Of an arm that errs by more than its files state, a page leaves the verdict open.
                fine = (0, 4) if block.run == "verdict" else (0,)
                line = line.replace("-i loopback", CAN) if bus and not short else line
                assert not line or typed(line, bus) in fine, command


@pytest.mark.parametrize(
    "topic", [pytest.param(t, marks=[pytest.mark.campaign] if t in LONG else []) for t in TOPICS]
)
def test_every_command_of_a_page_runs(topic, prepared, desk):
    type_page(topic, prepared, desk, short=True)


@pytest.mark.campaign
@pytest.mark.parametrize("topic", TOPICS)
def test_every_command_of_a_page_runs_as_it_is_written(topic, prepared, desk):
    type_page(topic, prepared, desk, short=False)


@pytest.mark.parametrize(
    "topic",
    [t for t in written_topics() if any(b.language == "python" and not b.file for b in blocks(t))],
)
def test_every_piece_of_python_runs(topic, desk, capsys):
    for block in blocks(topic):
        if block.language == "python" and not block.file:
            exec(compile(block.text, topic, "exec"), {})  # noqa: S102 - the page
    assert "theta_off_2" in capsys.readouterr().out


def test_nothing_is_written_that_no_test_runs():
    """Every line of a shell block is a command of ours or one of the system's."""
    for topic in TOPICS:
        for block in blocks(topic):
            assert block.language in ("sh", "yaml", "toml", "python", "text"), topic
            # The toy's are run by tests/system/test_arm_plugin.py.
            assert block.run in ("", "campaign", "verdict", "background", "terminal", "toy"), topic
            for command in filter(str.strip, block.commands):
                assert command.startswith(("sarcal ", *NOT_OURS)) or command == "sarcal", command
            assert block.language != "yaml" or block.file


def test_commands_have_parsers_that_take_them():
    """What a page has typed, or a sentence or a table quotes as a command, is one with options that it has."""
    from operator_app.commands.table import APP, COMMANDS, parser_of
    from operator_app.manual.pages import FOLDER

    for topic in written_topics():
        prose = re.sub(r"```.*?```", "", (FOLDER / f"{topic}.md").read_text(), flags=re.DOTALL)
        typed = [c.removeprefix("sarcal") for block in blocks(topic) for c in ours(block)]
        for quoted in typed + re.findall(r"`sarcal(?: ([^`]*))?`", " ".join(prose.split())):
            words = shlex.split(quoted)
            name = words[0] if words and not words[0].startswith("-") else APP
            assert name in {APP, *COMMANDS}, f"{topic}: {quoted}"
            known = {o for a in parser_of(name)._actions for o in a.option_strings}
            unknown = {w for w in words if w.startswith("-")} - known
            assert not unknown, f"{topic}: {quoted}"

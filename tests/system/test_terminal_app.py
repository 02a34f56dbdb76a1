"""The real program in a real terminal, on the virtual arm over its bus: Connect to Export, and worse."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from operator_app.config.parameters_file import load_parameters
from operator_app.session.store.folders import read_session
from operator_app.session.store.journal import JOURNAL_NAME, read_journal
from tests.oracles.own_process import controller, wait_for_poses
from tests.oracles.pty_program import PtyProgram
from tests.oracles.terminal import PATIENCE_S, POLL_S, Terminal, select

pytestmark = [pytest.mark.needs("tmux"), pytest.mark.real_time]

SARCAL = (str(Path(sys.executable).with_name("sarcal")), "--seed", "1", "--speed", "8")
POSES = 10


@pytest.fixture
def terminal(tmp_path):
    opened: list[Terminal] = []

    def open_terminal(*options: str, size=(120, 36), environment=None) -> Terminal:
        made = Terminal(
            tmp_path, [*SARCAL, "--poses", str(POSES), *options], size=size, environment=environment
        )
        opened.append(made)
        return made

    yield open_terminal
    for one in opened:
        one.close()


def the_session(root: Path) -> Path:
    (folder,) = [p.parent for p in root.glob(f"sessions/*/{JOURNAL_NAME}")]
    return folder


def follow(t: Terminal, *shown: str) -> None:
    """Press Enter each time that the footer, or the screen, shows this."""
    for words in shown:
        t.until(words)
        t.keys("Enter")


def answer(t: Terminal, question: str, *keys: str) -> None:
    t.until(question)
    t.keys(*keys)


def walk_to_capture(t: Terminal) -> None:
    """Follow the footer from Connect to Capture."""
    follow(t, "Enter Connect", "Enter Fixture", "Enter Tick", "Enter Modes")
    apply_modes(t)


def apply_modes(t: Terminal) -> None:
    """Follow the footer from Modes to Capture."""
    follow(t, "Enter Apply modes")
    answer(t, "Apply the modes?", "y")
    follow(t, "Enter Capture")
    t.until("Enter Automatic")


@pytest.mark.campaign
@pytest.mark.parametrize(
    "size", [pytest.param((120, 36), id="120x36"), pytest.param((80, 24), id="80x24")]
)
def test_connect_to_export_killed_in_mid_capture_and_resumed(terminal, tmp_path, size):
    t = terminal(size=size)
    walk_to_capture(t)
    t.keys("Enter")
    t.until(lambda screen: re.search(r"Poses +[3-9]/10", screen) is not None)
    t.kill(signal.SIGKILL)
    t.exit_code()
    t.close()
    folder = the_session(tmp_path)
    accepted = read_session(folder).state.poses
    assert 3 <= len(accepted) < POSES

    t = terminal(size=size)
    answer(t, "Resume?", "y")
    t.until(f"resumed: {len(accepted)} poses are kept")
    walk_to_capture(t)
    follow(t, "Enter Automatic", "Enter Calibrate", "Enter Solve")
    t.until("ACCEPTED")
    follow(t, "Enter Export", "Enter Write file", "Enter Upload")
    answer(t, "Upload to the controller?", *"SDA-0001", "Enter")
    follow(t, "Enter Finish")
    answer(t, "Leave?", "y")
    assert t.exit_code() == 0

    state = read_session(folder).state
    for before, after in zip(accepted, state.poses, strict=False):
        assert before.mean_rad.tolist() == after.mean_rad.tolist()
    assert [p.number for p in state.poses] == list(range(1, POSES + 1))
    assert load_parameters(folder / "parameters.yaml").quality.poses == POSES
    assert state.exported["uploaded"]["slot"]


@pytest.mark.campaign
def test_enter_pressed_before_there_is_a_screen_connects(terminal):
    t = terminal()
    t.keys("Enter")
    t.until("Enter Fixture")


@pytest.mark.campaign
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_in_mid_capture_ends_it_in_order(terminal, tmp_path, number):
    t = terminal()
    walk_to_capture(t)
    t.keys("Enter")
    t.until(lambda screen: re.search(r"Poses +[2-9]/10", screen) is not None)
    t.kill(number)
    assert t.exit_code() == 130
    events = read_journal(the_session(tmp_path)).events
    assert events[-1].name == "closed"
    assert events[-1].data["reason"] == number.name
    assert "sessions" in t.screen()
    assert "--resume" in t.screen()


@contextmanager
def capturing(folder: Path) -> Iterator[PtyProgram]:
    """The program in a pseudo-terminal, in automatic capture; it must end held, its journal closed."""
    program = PtyProgram([*SARCAL, "--poses", "40"], size=(120, 36), folder=folder)
    try:
        program.seen("Enter connects", 0)
        for key, text in WALK:
            program.press(key, text)
        yield program
        assert program.process.wait(PATIENCE_S) == 130
    finally:
        program.process.kill()
        program.close()
    contents = read_journal(the_session(folder))
    assert not contents.torn
    assert contents.events[-1].name == "closed"


@pytest.mark.campaign
def test_a_program_without_a_terminal_ends(tmp_path):
    """The kernel's SIGCONT makes Textual begin anew, on a terminal that is not there any more."""
    with capturing(tmp_path) as program:
        program.hang_up()
        program.process.send_signal(signal.SIGCONT)


@pytest.mark.campaign
@pytest.mark.parametrize("after_s", [0.2, 1.0, 4.0])
def test_a_terminal_that_goes_without_a_signal_ends_the_program(tmp_path, after_s):
    program = PtyProgram([*SARCAL, "--poses", "40"], size=(120, 36), folder=tmp_path)
    try:
        select(after_s)
        program.hang_up()
        # 2: it had not even looked whether there is a terminal.
        assert program.process.wait(PATIENCE_S) in (2, 130)
    finally:
        program.process.kill()
        program.close()


@pytest.mark.campaign
def test_a_terminal_that_is_not_read_ends_the_motion_and_a_signal_the_program(tmp_path):
    with capturing(tmp_path) as program:
        program.stop_reading()
        wait_for_poses(tmp_path / "sessions", 1, program.process)
        taken = -1
        while len(read_session(the_session(tmp_path)).state.poses) != taken:
            taken = len(read_session(the_session(tmp_path)).state.poses)
            select(5.0)
        assert taken < 40
        # The first of those who close must finish, whoever else wants to close meanwhile.
        send_again_and_again(program, signal.SIGTERM)


def send_again_and_again(program: PtyProgram, number: signal.Signals) -> None:
    for _ in range(int(PATIENCE_S / POLL_S)):
        program.process.send_signal(number)
        if program.process.poll() is not None:
            return
        select(POLL_S)


def test_what_cannot_be_opened_is_said_and_nothing_is_left_on_the_screen(tmp_path):
    program = PtyProgram([SARCAL[0], "--procedure", "nope"], size=(120, 36), folder=tmp_path)
    program.seen("neither a built-in procedure nor a file", 0)
    assert program.process.wait(PATIENCE_S) == 2
    program.close()


WALK = [
    (b"\r", "goes on to Fixture"),
    (b"\r", "Check list"),
    (b"\r", "goes on to Modes"),
    (b"\r", "Ranked"),
    (b"\r", "Apply the modes?"),
    (b"y", "goes on to Capture"),
    (b"\r", "What the poses determine"),
    (b"\r", "ANY KEY STOPS"),
]
"""From Connect to automatic capture: what is pressed and what is written then."""


@pytest.mark.campaign
def test_a_silent_bus_and_a_restarted_controller_lose_nothing(terminal, tmp_path):
    bus = ("-i", "loopback", "-c", f"app-{os.getpid()}")
    with controller(tmp_path, *bus, "--seed", "1") as (node, _):
        t = terminal(*bus)
        walk_to_capture(t)
        t.keys("Enter")
        t.until(lambda screen: re.search(r"Poses +[2-9]/10", screen) is not None)
        node.send_signal(signal.SIGSTOP)
        t.until("no data from the arm")
        t.until("DATA LOST quick stop sent")
        accepted = read_session(the_session(tmp_path)).state.poses
        node.send_signal(signal.SIGCONT)
        t.until("the data are back")
        t.keys("R")
        t.until("STOP reset")
        apply_modes_again(t)
    t.until("LOST")
    follow(t, "Enter To Connect")
    t.until("Enter Connect again")
    with controller(tmp_path, *bus, "--seed", "1"):
        t.keys("Enter")
        # The quick stop that the silence was answered with is latched still.
        follow(t, "Enter Reset STOP")
        t.until("Enter Fixture")
        apply_modes_again(t)
        t.keys("Enter")
        t.until("Enter Calibrate")
        t.keys("q")
        answer(t, "Leave?", "y")
        assert t.exit_code() == 0
    contents = read_journal(the_session(tmp_path))
    assert not contents.torn
    assert contents.events[-1].name == "closed"
    poses = read_session(the_session(tmp_path)).state.poses
    assert [p.number for p in poses] == list(range(1, POSES + 1))
    for before, after in zip(accepted, poses, strict=False):
        assert before.mean_rad.tolist() == after.mean_rad.tolist()


def apply_modes_again(t: Terminal) -> None:
    """Modes are forgotten with a stop or a restart; from any step to Capture."""
    t.keys("3")
    apply_modes(t)


@pytest.mark.campaign
def test_no_colour_means_none_and_ascii_means_ascii(terminal):
    t = terminal("--ascii", environment={"NO_COLOR": "1"})
    walk_to_capture(t)
    screen = t.screen(with_colours=True)
    codes = {code for found in re.findall(r"\x1b\[([0-9;]*)m", screen) for code in found.split(";")}
    # Bold, underline, reverse and their ends, and the default colours: nothing else.
    assert codes <= {"", "0", "1", "4", "7", "22", "24", "27", "39", "49"}, codes
    assert screen.isascii()


def test_without_a_terminal_it_says_what_to_do():
    done = subprocess.run(
        SARCAL, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "--plain" in done.stderr

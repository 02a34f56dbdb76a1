"""The program in a real terminal, on the virtual arm over its bus: Connect to Export, kills, lost terminals."""

import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from operator_app.config.parameters_file import load_parameters
from operator_app.session.store.folders import read_session
from operator_app.session.store.journal import JOURNAL_NAME, read_journal
from tests.oracles.own_process import controller, wait_for_poses
from tests.oracles.pty_program import WALK, PtyProgram
from tests.oracles.terminal import PATIENCE_S, POLL_S, Terminal, select

pytestmark = [pytest.mark.needs("tmux"), pytest.mark.real_time, pytest.mark.campaign]

SARCAL = (str(Path(sys.executable).with_name("sarcal")), "--seed", "1", "--speed", "8")
POSES = 10
SIZE = (120, 36)


@pytest.fixture
def terminal(tmp_path):
    opened: list[Terminal] = []

    def open_terminal(*options: str, size=SIZE, environment=None) -> Terminal:
        command = [*SARCAL, "--poses", str(POSES), *options]
        opened.append(Terminal(tmp_path, command, size=size, environment=environment))
        return opened[-1]

    yield open_terminal
    for one in opened:
        one.close()


def only_session(root: Path) -> Path:
    (folder,) = [p.parent for p in root.glob(f"sessions/*/{JOURNAL_NAME}")]
    return folder


def follow(t: Terminal, *shown: str) -> None:
    """Press Enter each time that the footer, or the screen, shows the next text."""
    for text in shown:
        t.until(text)
        t.keys("Enter")


def answer(t: Terminal, question: str, *keys: str) -> None:
    t.until(question)
    t.keys(*keys)


def start_capture(t: Terminal, *, poses: int = 2) -> None:
    walk_to_capture(t)
    t.keys("Enter")
    t.until(lambda screen: re.search(rf"Poses +[{poses}-9]/10", screen) is not None)


def walk_to_capture(t: Terminal) -> None:
    follow(t, "Enter Connect", "Enter Fixture", "Enter Tick", "Enter Modes")
    apply_modes(t)


def apply_modes(t: Terminal) -> None:
    follow(t, "Enter Apply modes")
    answer(t, "Apply the modes?", "y")
    follow(t, "Enter Capture")
    t.until("Enter Automatic")


@pytest.mark.parametrize("size", [SIZE, (80, 24)])
def test_session_killed_during_capture_is_resumed_and_exported(terminal, tmp_path, size):
    t = terminal(size=size)
    start_capture(t, poses=3)
    t.kill(signal.SIGKILL)
    t.exit_code()
    t.close()
    folder = only_session(tmp_path)
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


def test_enter_before_the_first_screen_connects(terminal):
    t = terminal()
    t.keys("Enter")
    t.until("Enter Fixture")


def assert_journal_closed(root: Path) -> None:
    journal = read_journal(only_session(root))
    assert not journal.torn
    assert journal.events[-1].name == "closed"


@contextmanager
def capturing(folder: Path) -> Iterator[PtyProgram]:
    """Run automatic capture in a pseudo-terminal; it must end with exit code 130 and a closed journal."""
    program = PtyProgram([*SARCAL, "--poses", "40"], size=SIZE, folder=folder)
    try:
        program.seen("Enter connects", 0)
        for key, text in WALK:
            program.press(key, text)
        yield program
        assert program.process.wait(PATIENCE_S) == 130
    finally:
        program.process.kill()
        program.close()
    assert_journal_closed(folder)


def test_sigcont_after_terminal_loss_ends_the_program(tmp_path):
    """SIGCONT makes Textual restart on a terminal that no longer exists."""
    with capturing(tmp_path) as program:
        program.close_terminal()
        program.process.send_signal(signal.SIGCONT)


@pytest.mark.parametrize("after_s", [0.2, 1.0, 4.0])
def test_terminal_loss_without_a_signal_ends_the_program(tmp_path, after_s):
    program = PtyProgram([*SARCAL, "--poses", "40"], size=SIZE, folder=tmp_path)
    try:
        select(after_s)
        program.close_terminal()
        # 2: the terminal was lost before the program looked for one.
        assert program.process.wait(PATIENCE_S) in (2, 130)
    finally:
        program.process.kill()
        program.close()


def test_unread_terminal_ends_motion_and_signals_end_the_program(tmp_path):
    with capturing(tmp_path) as program:
        program.stop_reading()
        wait_for_poses(tmp_path / "sessions", 1, program.process)
        count = -1
        while len(read_session(only_session(tmp_path)).state.poses) != count:
            count = len(read_session(only_session(tmp_path)).state.poses)
            select(5.0)
        assert count < 40
        # Repeated signals do not interrupt the first close.
        for _ in range(int(PATIENCE_S / POLL_S)):
            program.process.send_signal(signal.SIGTERM)
            if program.process.poll() is not None:
                break
            select(POLL_S)


def test_silent_bus_and_restarted_controller_lose_no_pose(terminal, tmp_path):
    bus = ("-i", "loopback", "-c", f"app-{os.getpid()}")
    with controller(tmp_path, *bus, "--seed", "1") as (node, _):
        t = terminal(*bus)
        start_capture(t)
        node.send_signal(signal.SIGSTOP)
        t.until("no data from the arm")
        t.until("DATA LOST quick stop sent")
        accepted = read_session(only_session(tmp_path)).state.poses
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
        # The quick stop that was sent during the silence is still latched.
        follow(t, "Enter Reset STOP")
        t.until("Enter Fixture")
        apply_modes_again(t)
        t.keys("Enter")
        t.until("Enter Calibrate")
        t.keys("q")
        answer(t, "Leave?", "y")
        assert t.exit_code() == 0
    assert_journal_closed(tmp_path)
    poses = read_session(only_session(tmp_path)).state.poses
    assert [p.number for p in poses] == list(range(1, POSES + 1))
    for before, after in zip(accepted, poses, strict=False):
        assert before.mean_rad.tolist() == after.mean_rad.tolist()


def apply_modes_again(t: Terminal) -> None:
    """Go from any step to Capture: a stop or restart resets the modes."""
    t.keys("3")
    apply_modes(t)


@pytest.mark.parametrize(("options", "encoding"), [(("--ascii",), "utf-8"), ((), "latin-1")])
def test_no_color_and_ascii_are_respected(terminal, options, encoding):
    t = terminal(*options, environment={"NO_COLOR": "1", "PYTHONIOENCODING": encoding})
    walk_to_capture(t)
    screen = t.screen(with_colours=True)
    codes = {*";".join(re.findall(r"\x1b\[([0-9;]*)m", screen)).split(";")}
    # Bold, underline, reverse and their ends, and the default colours.
    assert codes <= {"", "0", "1", "4", "7", "22", "24", "27", "39", "49"}, codes
    assert screen.isascii()

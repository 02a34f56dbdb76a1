"""The real program in a real terminal, on the virtual arm over its bus: Connect to Export, and worse."""

from __future__ import annotations

import re
import signal
import sys
from pathlib import Path

import pytest

from operator_app.config.parameters_file import load_parameters
from operator_app.session.folder import read_session
from operator_app.session.journal import JOURNAL_NAME, read_journal
from oracles.terminal import Terminal

pytestmark = pytest.mark.needs("tmux")

SARCAL = (str(Path(sys.executable).with_name("sarcal")), "--seed", "1", "--speed", "8")
POSES = 10
SIZES = [(120, 36), (80, 24)]


@pytest.fixture
def terminal(tmp_path):
    opened: list[Terminal] = []

    def open_terminal(*options: str, size=(120, 36), environment=None) -> Terminal:
        made = Terminal(
            tmp_path,
            [*SARCAL, "--poses", str(POSES), *options],
            size=size,
            environment=environment,
        )
        opened.append(made)
        return made

    yield open_terminal
    for one in opened:
        one.close()


def the_session(root: Path) -> Path:
    (folder,) = [p.parent for p in root.glob(f"sessions/*/{JOURNAL_NAME}")]
    return folder


def walk_to_capture(t: Terminal) -> None:
    """Follow the footer from Connect to Capture."""
    t.until("Enter Connect")
    t.keys("Enter")
    t.until("Enter Fixture")
    t.keys("Enter")
    t.until("Enter Tick")
    t.keys("Enter")
    t.until("Enter Modes")
    t.keys("Enter")
    t.until("Enter Apply modes")
    t.keys("Enter")
    t.until("Apply the modes?")
    t.keys("y")
    t.until("Enter Capture")
    t.keys("Enter")
    t.until("Enter Automatic")


@pytest.mark.parametrize("size", SIZES, ids=["120x36", "80x24"])
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
    t.until("Resume?")
    t.keys("y")
    t.until(f"resumed: {len(accepted)} poses are kept")
    walk_to_capture(t)
    t.keys("Enter")
    t.until("Enter Calibrate")
    t.keys("Enter")
    t.until("Enter Solve")
    t.keys("Enter")
    t.until("ACCEPTED")
    t.until("Enter Export")
    t.keys("Enter")
    t.until("Enter Write file")
    t.keys("Enter")
    t.until("Enter Upload")
    t.keys("Enter")
    t.until("Upload to the controller?")
    t.keys(*"SDA-0001", "Enter")
    t.until("Enter Finish")
    t.keys("Enter")
    t.until("Leave?")
    t.keys("y")
    assert t.exit_code() == 0

    state = read_session(folder).state
    for before, after in zip(accepted, state.poses, strict=False):
        assert before.mean_rad.tolist() == after.mean_rad.tolist()
    assert [p.number for p in state.poses] == list(range(1, POSES + 1))
    assert load_parameters(folder / "parameters.yaml").quality.poses == POSES
    assert state.exported["uploaded"]["slot"]


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


def test_a_closed_terminal_leaves_the_journal_whole_and_closed(terminal, tmp_path):
    t = terminal()
    walk_to_capture(t)
    t.keys("Enter")
    t.until(lambda screen: re.search(r"Poses +[2-9]/10", screen) is not None)
    pid = t.pid()
    t.close_window()
    wait_for_end(pid)
    contents = read_journal(the_session(tmp_path))
    assert not contents.torn
    assert contents.events[-1].name == "closed"


def wait_for_end(pid: int) -> None:
    from oracles.terminal import PATIENCE_S, POLL_S, select

    for _ in range(int(PATIENCE_S / POLL_S)):
        if not Path(f"/proc/{pid}").exists():
            return
        select(POLL_S)
    raise AssertionError("the program goes on without a terminal")


def test_no_colour_means_none_and_ascii_means_ascii(terminal):
    t = terminal("--ascii", environment={"NO_COLOR": "1"})
    walk_to_capture(t)
    screen = t.screen(with_colours=True)
    codes = {code for found in re.findall(r"\x1b\[([0-9;]*)m", screen) for code in found.split(";")}
    # Bold, underline, reverse and their ends, and the default colours: nothing else.
    assert codes <= {"", "0", "1", "4", "7", "22", "24", "27", "39", "49"}, codes
    assert screen.isascii()


def test_without_a_terminal_it_says_what_to_do():
    import subprocess

    done = subprocess.run(
        SARCAL, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "--plain" in done.stderr

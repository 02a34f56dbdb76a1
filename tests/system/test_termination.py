"""Signals, pipes, terminals and threads at the end of the program: it ends, and its exit code gives the reason."""

import itertools
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from tests.oracles.own_process import SARCAL, finished, start
from tests.oracles.pty_program import PtyProgram


def test_tracker_still_writing_does_not_change_exit_code(tmp_path):
    with subprocess.Popen(
        [*SARCAL, "run", "open_loop", "--poses", "4", "--tracker", "stdin"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        bufsize=1,
        cwd=tmp_path,
    ) as process:
        with suppress(BrokenPipeError):
            while process.poll() is None:
                process.stdin.write('{"error": "no light"}\n')
                time.sleep(0.02)
        output = process.stdout.read()
        with suppress(BrokenPipeError):  # unread input is flushed
            process.stdin.close()
    assert process.returncode == 3, output
    assert "no light" in output


PAIRS = (
    (signal.SIGINT, signal.SIGTERM),
    (signal.SIGHUP, signal.SIGTERM),
    (signal.SIGINT, signal.SIGINT),
)
TIMES_S = tuple(itertools.product((0.0, 0.7, 3.0), (0.0, 0.01, 0.1, 0.4)))
"""Times from the first message to the first signal, and from the first to the second signal."""


@pytest.mark.parametrize(
    ("pair", "times_s"),
    [
        (PAIRS[0], [(0.0, 0.1)]),
        *(pytest.param(pair, TIMES_S, marks=pytest.mark.campaign) for pair in PAIRS),
    ],
)
def test_second_signal_does_not_change_exit_code(tmp_path, pair, times_s):
    for wait_s, gap_s in times_s:
        process = start(tmp_path, "run", "--poses", "40")
        assert process.stderr.readline()
        time.sleep(wait_s)
        process.send_signal(pair[0])
        time.sleep(gap_s)
        process.send_signal(pair[1])
        finished(process, 130)


WITH_BLOCKED_THREAD = """
import sys, threading
from operator_app.cli import main
threading.Thread(target=threading.Event().wait).start()
sys.argv = ["sarcal", *sys.argv[1:]]
sys.exit(main())
"""


@pytest.mark.parametrize(("arguments", "code"), [(["--version"], 0), (["report", "nothing"], 2)])
def test_program_ends_despite_a_blocked_thread(arguments, code):
    program = [sys.executable, "-c", WITH_BLOCKED_THREAD, *arguments]
    assert subprocess.run(program, check=False, timeout=240).returncode == code


@pytest.mark.campaign
def test_run_under_nohup_ignores_a_hang_up(tmp_path):
    with subprocess.Popen(
        ["nohup", *SARCAL, "run", "--poses", "3"], stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        process.stderr.readline()
        process.send_signal(signal.SIGHUP)
        errors = process.stderr.read()
    assert process.returncode in (0, 4), errors


def test_unknown_procedure_is_reported_without_a_screen(tmp_path):
    program = PtyProgram([*SARCAL, "--procedure", "nope"], size=(120, 36), folder=tmp_path)
    program.seen("neither a built-in procedure nor a file", 0)
    assert program.process.wait(240) == 2
    program.close()


def test_app_without_a_terminal_suggests_plain_mode():
    result = subprocess.run(
        SARCAL, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert result.returncode == 2
    assert "--plain" in result.stderr

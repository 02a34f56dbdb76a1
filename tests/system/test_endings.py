"""However a program is made to end, its exit code says why, and it does end."""

import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

SARCAL = (sys.executable, "-m", "operator_app.cli")


def test_a_tracker_that_still_writes_changes_no_exit_code(tmp_path):
    with subprocess.Popen(
        [*SARCAL, "run", "open_loop", "--poses", "4", "--tracker", "stdin"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        bufsize=1,
        cwd=tmp_path,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(BrokenPipeError):
            while process.poll() is None:
                process.stdin.write('{"error": "no light"}\n')
                time.sleep(0.02)
        said = process.stdout.read()
        with suppress(BrokenPipeError):  # what it did not read is flushed
            process.stdin.close()
    assert process.returncode == 3, said
    assert "no light" in said


def twice_interrupted(
    folder: Path, first: signal.Signals, second: signal.Signals, wait_s: float, gap_s: float
) -> tuple[int, str]:
    """Exit code and messages of a run that gets two signals as soon as it has begun, or later."""
    with subprocess.Popen(
        [*SARCAL, "run", "--poses", "40"], stderr=subprocess.PIPE, text=True, cwd=folder
    ) as process:
        assert process.stderr is not None
        begun = process.stderr.readline()
        time.sleep(wait_s)
        process.send_signal(first)
        time.sleep(gap_s)
        process.send_signal(second)
        said = begun + process.stderr.read()
    return process.returncode, said


PAIRS = (
    (signal.SIGINT, signal.SIGTERM),
    (signal.SIGHUP, signal.SIGTERM),
    (signal.SIGINT, signal.SIGINT),
)


SOON = (0.0,), (0.1,)
ANY_TIME = (0.0, 0.1, 0.3, 0.7, 1.5, 3.0), (0.0, 0.001, 0.01, 0.05, 0.1, 0.4)


@pytest.mark.parametrize(
    ("pair", "waits_s", "gaps_s"),
    [
        (PAIRS[0], *SOON),
        *(pytest.param(pair, *ANY_TIME, marks=pytest.mark.campaign) for pair in PAIRS),
    ],
)
def test_a_second_signal_at_any_time_does_not_change_the_exit_code(tmp_path, pair, waits_s, gaps_s):
    for wait_s in waits_s:
        for gap_s in gaps_s:
            code, said = twice_interrupted(tmp_path, *pair, wait_s, gap_s)
            assert code == 130, (wait_s, gap_s, said)


STUCK = """
import sys, threading
from operator_app.cli import main
threading.Thread(target=threading.Event().wait).start()
sys.argv = ["sarcal", *sys.argv[1:]]
sys.exit(main())
"""


@pytest.mark.parametrize(("arguments", "code"), [(["--version"], 0), (["report", "nothing"], 2)])
def test_a_thread_that_stays_does_not_keep_the_process(arguments, code):
    done = subprocess.run([sys.executable, "-c", STUCK, *arguments], check=False, timeout=60)
    assert done.returncode == code


@pytest.mark.campaign
def test_who_ignores_a_hang_up_goes_on(tmp_path):
    with subprocess.Popen(
        ["nohup", *SARCAL, "run", "--poses", "3"], stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        process.stderr.readline()
        process.send_signal(signal.SIGHUP)
        said = process.stderr.read()
    assert process.returncode in (0, 4), said

"""Ctrl-C ends a campaign of kills and faults in one line, with every program that it began and every file."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import uuid
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MARK = "SARCAL_CAMPAIGN"
PATIENCE_S = 120.0


def fit_residuals(mark: str) -> list[int]:
    """Processes that were begun with this mark and do not end by themselves at once."""
    found = []
    for proc in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if f"{MARK}={mark}".encode() in (proc / "environ").read_bytes().split(b"\0"):
                ended = os.pidfd_open(int(proc.name))
                if not select.select([ended], [], [], 10.0)[0]:
                    found.append(int(proc.name))
                os.close(ended)
    return found


@pytest.mark.campaign
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("arguments", "at_work"),
    [
        (["--kills", "24", "--without-faults"], "*/chain-*/run-*.txt"),
        (["--kills", "0"], "**/s/journal.jsonl"),
    ],
    ids=["kills", "faults"],
)
def test_it_ends_with_all_that_it_began(
    tmp_path: Path, number: signal.Signals, arguments: list[str], at_work: str
) -> None:
    mark = uuid.uuid4().hex
    program = subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.campaign", "--processes", "2", *arguments],
        cwd=ROOT,
        env={**os.environ, "TMPDIR": str(tmp_path), MARK: mark},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not list(tmp_path.glob(at_work)):
        with suppress(subprocess.TimeoutExpired):
            program.wait(0.05)
            raise AssertionError(program.communicate()[1])
    # A terminal's Ctrl-C goes to all of its foreground; `timeout` tells the program.
    if number is signal.SIGINT:
        os.killpg(program.pid, number)
    else:
        program.send_signal(number)
    try:
        out, said = program.communicate(timeout=PATIENCE_S)
        assert program.returncode == 130
        assert said.splitlines() == ["ended before its time; nothing of it goes on"]
        assert out == ""
        assert fit_residuals(mark) == []
        assert list(tmp_path.iterdir()) == []
    finally:
        for pid in fit_residuals(mark):
            os.kill(pid, signal.SIGKILL)

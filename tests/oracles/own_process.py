"""The program as a separate process, run from these sources."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.oracles.answers import Answer

ROOT = Path(__file__).resolve().parents[2]
SARCAL = [sys.executable, "-m", "operator_app.cli"]


def environment() -> dict[str, str]:
    """Environment in which the program can be run from any folder."""
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*SARCAL, *arguments],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finished(process: subprocess.Popen[str], *codes: int, patience_s: float = 240.0) -> Answer:
    """Wait until a command ends with one of these exit codes, and return its output."""
    try:
        out, err = process.communicate(timeout=patience_s)
    finally:
        process.kill()
    assert process.returncode in codes, err
    assert "Traceback" not in err
    return Answer(out=out, err=err)


@contextmanager
def controller(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run a virtual controller, and kill it at the end: its process and its first line."""
    process = start(folder, "controller", *arguments)
    try:
        assert process.stderr is not None
        yield process, process.stderr.readline()
    finally:
        process.kill()
        process.communicate()


def wait_for_poses(sessions: Path, count: int, process: subprocess.Popen[str]) -> Path:
    """Wait until a journal has `count` poses, and return its folder; fails if the command ends before."""
    while True:
        for journal in sessions.glob("*/journal.jsonl"):
            if journal.read_bytes().count(b'"event":"pose"') >= count:
                return journal.parent
        with suppress(subprocess.TimeoutExpired):
            # Sleep, so that the program can send its heartbeat.
            process.wait(0.02)
            raise AssertionError(process.communicate()[1])

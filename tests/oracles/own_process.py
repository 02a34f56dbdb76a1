"""The program as a process of its own, run from these sources."""

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
    """Return an environment in which another folder's Python finds the program."""
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a command in a folder; what it says is kept in pipes."""
    return subprocess.Popen(
        [*SARCAL, *arguments],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finished(process: subprocess.Popen[str], *codes: int, patience_s: float = 240.0) -> Answer:
    """Wait for a command, which must end with one of these exit codes, and return what it said."""
    try:
        out, err = process.communicate(timeout=patience_s)
    finally:
        process.kill()
    assert process.returncode in codes, err
    assert "Traceback" not in err
    return Answer(out=out, err=err)


@contextmanager
def controller(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run a virtual controller, which is killed in the end: its process and its first line."""
    process = start(folder, "controller", *arguments)
    try:
        assert process.stderr is not None
        yield process, process.stderr.readline()
    finally:
        process.kill()
        process.communicate()


def wait_for_poses(sessions: Path, wanted: int, process: subprocess.Popen[str]) -> Path:
    """Wait until a journal holds so many poses, and return its folder; an error if the command ends before."""
    while True:
        for journal in sessions.glob("*/journal.jsonl"):
            if journal.read_bytes().count(b'"event":"pose"') >= wanted:
                return journal.parent
        with suppress(subprocess.TimeoutExpired):
            # Not in a spin: the program needs the processor to keep its heartbeat.
            process.wait(0.02)
            raise AssertionError(process.communicate()[1])

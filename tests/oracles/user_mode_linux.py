"""A kernel's own vcan0 without privileges: commands under User-Mode Linux. Skips where there is none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
RUNNER = REPOSITORY / "tests" / "tools" / "in_user_mode_linux.py"
UNFIT = "ptrace set fp regs failed"
"""What the kernel dies of, before it has started anything, on processors with larger registers than
it has room for."""


def in_user_mode_linux(*command: str, patience_s: float = 170.0) -> str:
    """Run a command as root with a vcan0 that is up; return what it printed.

    It runs in the repository, and may write to /run only. Skips on a processor that User-Mode Linux
    cannot run on.
    """
    done = subprocess.run(
        [
            sys.executable, str(RUNNER), "/usr/bin/env", "-C", str(REPOSITORY), "TMPDIR=/run",
            f"PYTHONPATH={REPOSITORY}", *command,
        ],
        capture_output=True,
        text=True,
        timeout=patience_s,
        check=False,
    )  # fmt: skip
    if done.returncode and UNFIT in done.stdout:
        pytest.skip(f"User-Mode Linux does not run on this processor: {UNFIT}")
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-1000:]
    return done.stdout

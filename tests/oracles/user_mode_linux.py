"""A kernel's own vcan0 without privileges: commands under User-Mode Linux. Skips where there is none."""

import contextlib
import os
import signal
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
    running = subprocess.Popen(
        [
            sys.executable, str(RUNNER), "/usr/bin/env", "-C", str(REPOSITORY), "TMPDIR=/run",
            f"PYTHONPATH={REPOSITORY}", *command,
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        said, complaint = running.communicate(timeout=patience_s)
    finally:
        # Each process of the guest is one of the host's: they outlive their kernel's parent.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
    if running.returncode and UNFIT in said:
        pytest.skip(f"User-Mode Linux does not run on this processor: {UNFIT}")
    assert running.returncode == 0, said[-4000:] + complaint[-1000:]
    return said

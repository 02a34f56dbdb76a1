"""Commands in a guest Linux with a vcan0: User-Mode Linux. Skips on a processor on which that does not run."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
UNFIT = "ptrace set fp regs failed"
"""Error of User-Mode Linux at its start on a processor with registers that it does not support."""


def in_user_mode_linux(*command: str, patience_s: float = 550.0) -> str:
    """Run a command as root in the repository, with a vcan0 that is up and a writable /run; return its output."""
    process = subprocess.Popen(
        [
            sys.executable, str(REPOSITORY / "tests/tools/in_user_mode_linux.py"), "/usr/bin/env",
            "-C", str(REPOSITORY), "TMPDIR=/run", "HOME=/run", f"PYTHONPATH={REPOSITORY}", *command,
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        output, errors = process.communicate(timeout=patience_s)
    finally:
        # The processes of User-Mode Linux are the host's, and outlive their parent.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    if process.returncode and UNFIT in output:
        pytest.skip(f"User-Mode Linux does not run on this processor: {UNFIT}")
    assert process.returncode == 0, output[-4000:] + errors[-1000:]
    return output

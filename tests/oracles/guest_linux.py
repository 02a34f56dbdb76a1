"""A kernel's own vcan0: commands under User-Mode Linux, or under an emulated PC. Skips where there is none."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
UNFIT = "ptrace set fp regs failed"
"""What User-Mode Linux dies of, before it has started anything, where registers are larger than it has room for."""
LACKS = "install Debian package"
"""What the emulated PC's runner ends in where it finds no kernel or no static busybox."""


def _inside(runner: str, command: tuple[str, ...], patience_s: float) -> str:
    """Run a command as root with a vcan0 that is up; return what it printed.

    It runs in the repository, and may write to /run only.
    """
    running = subprocess.Popen(
        [
            sys.executable, str(REPOSITORY / "tests" / "tools" / runner), "/usr/bin/env", "-C", str(REPOSITORY),
            "TMPDIR=/run", "HOME=/run", f"PYTHONPATH={REPOSITORY}", *command,
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        said, complaint = running.communicate(timeout=patience_s)
    finally:
        # Each process of User-Mode Linux is one of the host's: they outlive their kernel's parent.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
    if running.returncode and UNFIT in said:
        pytest.skip(f"User-Mode Linux does not run on this processor: {UNFIT}")
    if LACKS in complaint:
        pytest.skip(complaint.strip().splitlines()[-1])
    assert running.returncode == 0, said[-4000:] + complaint[-1000:]
    return said


def in_user_mode_linux(*command: str, patience_s: float = 170.0) -> str:
    """Run a command without privileges of the host; skips on a processor that User-Mode Linux cannot run on."""
    return _inside("in_user_mode_linux.py", command, patience_s)


def in_emulated_linux(*command: str, patience_s: float = 900.0) -> str:
    """Run a command on any processor."""
    return _inside("in_qemu.py", command, patience_s)

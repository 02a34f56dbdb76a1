"""A kernel's own vcan0 on any processor: commands under an emulated PC. Skips where there is none to be had."""

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
RUNNER = REPOSITORY / "tests" / "tools" / "in_qemu.py"
LACKS = "install Debian package"
"""What the runner ends in where it finds no kernel or no static busybox."""


def in_emulated_linux(*command: str, patience_s: float = 900.0) -> str:
    """Run a command as root with a vcan0 that is up; return what it printed.

    It runs in the repository, and may write to /run only.
    """
    done = subprocess.run(
        [
            sys.executable, str(RUNNER), "/usr/bin/env", "-C", str(REPOSITORY), "TMPDIR=/run", "HOME=/run",
            f"PYTHONPATH={REPOSITORY}", *command,
        ],
        capture_output=True,
        text=True,
        timeout=patience_s,
        check=False,
    )  # fmt: skip
    if LACKS in done.stderr:
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-1000:]
    return done.stdout

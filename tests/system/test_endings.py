"""However a program is made to end, its exit code says why, and it does end."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

SARCAL = (sys.executable, "-m", "operator_app.cli")


def test_a_tracker_that_still_writes_changes_no_exit_code(tmp_path: Path) -> None:
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
        try:
            while process.poll() is None:
                process.stdin.write('{"error": "no light"}\n')
                time.sleep(0.02)
        except BrokenPipeError:
            pass
        said = process.stdout.read()
    assert process.returncode == 3, said
    assert "no light" in said

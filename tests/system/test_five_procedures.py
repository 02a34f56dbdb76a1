"""The five procedures, each twice in a row on one controller in another process, and their verifications.

The programs, and the table of what was run, are those of `five_procedures.py`; here with few poses.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.real_time


@pytest.mark.campaign
def test_each_is_accepted_twice_in_a_row_and_verified() -> None:
    script = Path(__file__).with_name("five_procedures.py")
    done = subprocess.run(
        [sys.executable, str(script), "--few"], capture_output=True, text=True, check=False
    )
    print(done.stdout)  # noqa: T201 - the table is what a reader wants to see
    assert done.returncode == 0, done.stdout + done.stderr
    assert "16 of 16 accepted" in done.stdout

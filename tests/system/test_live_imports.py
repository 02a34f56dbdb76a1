"""Nothing compiled is loaded while an arm is live: opening a library keeps the interpreter, and SYNC waits."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
from hardware.control.control_loop import ControlLoop

begin, live = ControlLoop.begin_sync, []

def begin_sync(loop):
    live.append(loop)
    begin(loop)

def loaded(event, arguments):
    if event == "import" and live and arguments[0].partition(".")[0] in ("numpy", "scipy"):
        print("LIVE", arguments[0])

ControlLoop.begin_sync = begin_sync
sys.addaudithook(loaded)
from operator_app.cli import main
code = main(sys.argv[1:])
print("arms", len(live), "exit code", code)
"""


@pytest.mark.campaign
@pytest.mark.parametrize("procedure", ["hinge", "hinge_planned"])
def test_no_library_is_loaded_while_an_arm_is_live(procedure, tmp_path):
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, "run", procedure, "--seed", "1"],
        capture_output=True, text=True, check=True, cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])},
    )  # fmt: skip
    assert "arms 1 exit code 0" in ended.stdout
    assert [line for line in ended.stdout.splitlines() if line.startswith("LIVE")] == []

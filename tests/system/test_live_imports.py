"""No compiled library is loaded while an arm is live: loading blocks the interpreter and delays SYNC."""

import subprocess
import sys

import pytest

from tests.oracles.own_process import environment

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
def test_no_library_is_imported_while_an_arm_is_connected(procedure, tmp_path):
    command = [sys.executable, "-c", PROGRAM, "run", procedure, "--seed", "1"]
    out = subprocess.check_output(command, text=True, cwd=tmp_path, env=environment())
    assert "arms 1 exit code 0" in out
    assert [line for line in out.splitlines() if line.startswith("LIVE")] == []

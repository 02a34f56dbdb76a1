"""The process that solves: same result, ended at once, alone, and never left behind."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from hardware.timing import real_time_priority
from operator_app.calibration.calibrate import calibrate
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from operator_app.errors import Cancelled, SessionError
from operator_app.session.store.solver_process import NICENESS, SolvingProcess
from solver.errors import UnidentifiableError
from tests.oracles import solving_jobs as jobs

PATIENCE_S = 60.0


def gone(pid: int) -> bool:
    """Whether a process has ended; one that nobody has waited for yet has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def wait_until_gone(pid: int) -> None:
    for _ in range(int(PATIENCE_S / 0.01)):
        if gone(pid):
            return
        threading.Event().wait(0.01)
    raise AssertionError(f"process {pid} is still there")


def test_a_solver_process_gives_the_same_result(reference_data):
    poses = load_poses(reference_data / "hinge" / "hinge_quantised.csv").poses
    arguments = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture, poses

    def result_of(call, *function):
        numbers: list[int] = []
        result = call(*function, *arguments, progress=lambda number, _: numbers.append(number))
        return result, numbers

    here, progress_here = result_of(calibrate)
    with SolvingProcess() as process:
        there, progress_there = result_of(process, calibrate)
    assert progress_there == progress_here
    np.testing.assert_allclose(there.estimate.x, here.estimate.x, rtol=1e-9)
    np.testing.assert_allclose(there.estimate.covariance, here.estimate.covariance, rtol=1e-6)
    assert (there.reasons, there.warnings) == (here.reasons, here.warnings)


def test_a_solver_process_has_no_bus_terminal_or_screen():
    with SolvingProcess() as process:
        state = process(jobs.process_state)
        assert state["pid"] != os.getpid()
        assert state["session"] == state["pid"]
        assert not {"textual", "rich", "can", "canopen", "pydantic"} & set(state["modules"])
        kinds = {name.partition(":")[0] for name in state["open"]}
        assert kinds <= {"/dev/null", "pipe", "socket"}, state["open"]
        assert sum(name.startswith("socket:") for name in state["open"]) == 1


def test_a_solver_process_works_in_sequence_and_ends():
    with SolvingProcess() as process:
        numbers: list[int] = []
        assert process(jobs.count, 5, progress=lambda n, _: numbers.append(n)) == 5
        assert numbers == [0, 1, 2, 3, 4]
        first, second = (process(jobs.process_state)["pid"] for _ in range(2))
        assert first == second
    wait_until_gone(first)


def test_cancelling_ends_the_process_at_once(tmp_path):
    ended = threading.Event()

    def go_on() -> None:
        if ended.is_set():
            raise Cancelled

    pids: list[int] = []

    def progress(number: int, _: float) -> None:
        pids.append(number)
        ended.set()

    with pytest.raises(Cancelled), SolvingProcess(go_on) as process:
        process(jobs.never, str(tmp_path / "mark"), progress=progress)
    wait_until_gone(pids[0])


@pytest.mark.parametrize(
    ("job", "words"),
    [
        ((jobs.fail_with_defect,), "Program error: ZeroDivisionError"),
        ((jobs.die, "killed"), r"ended by itself \(signal SIGKILL\)"),
        ((jobs.die, "exit"), r"ended by itself \(exit code 7\)"),
    ],
)
def test_exceptions_become_messages(job, words):
    with SolvingProcess() as process, pytest.raises(SessionError, match=words) as caught:
        process(*job)
    assert caught.value.remedy


def test_solver_errors_are_raised_unchanged():
    with SolvingProcess() as process, pytest.raises(UnidentifiableError) as caught:
        process(jobs.fail_unidentifiable, "theta_off_6")
    assert caught.value.directions[0].parameters == ("theta_off_6",)
    assert caught.value.note == "one note"


def test_solving_has_low_priority():
    with real_time_priority(), SolvingProcess() as process:
        policy, niceness = process(jobs.turn)
    assert policy == os.SCHED_OTHER
    assert niceness >= min(19, os.getpriority(os.PRIO_PROCESS, 0) + NICENESS)


PARENT = """
import sys
from operator_app.session.store.solver_process import SolvingProcess
from tests.oracles import solving_jobs as jobs
with SolvingProcess() as process:
    process(jobs.never, sys.argv[1], progress=lambda *_: print("solving", flush=True))
"""


def test_a_solver_process_ends_with_its_killed_parent(tmp_path):
    mark = tmp_path / "pid"
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(mark)],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert parent.stdout.readline() == b"solving\n"
    child = int(mark.read_text("utf-8"))
    assert not gone(child)
    parent.kill()
    parent.communicate()
    wait_until_gone(child)

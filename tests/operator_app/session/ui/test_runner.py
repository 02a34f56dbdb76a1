"""The runner of a session's tasks: what it shows of them, their order, and how they end."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from unittest.mock import Mock

import pytest

from hardware.arm import HostLatency
from hardware.errors import BusError
from operator_app.errors import SessionError
from operator_app.session.ui.runner import WATCH_PERIOD_S, Runner
from operator_app.session.ui.snapshot import Level, TaskKind
from operator_app.session.ui.supervisor import UNWATCHED_S
from operator_app.session.workflow.drive_selection import waypoints_of
from tests.oracles.journal_events import event_data
from tests.oracles.plant_sessions import short_procedure

PATIENCE_S = 120.0


@pytest.fixture
def runner(source):
    return source.new()


@pytest.fixture
def arm(source, runner):
    runner.submit(TaskKind.CONNECT, "connecting", runner.operations.connect)
    finish(runner)
    assert source.arm is not None
    return source.arm


@pytest.fixture
def work(runner):
    """Operations of a connected arm with its modes set."""
    runner.operations.connect()
    runner.operations.set_modes((1, 5))
    return runner.operations


class Task:
    """A task that lasts until a condition holds, or `go_on` is set; `begun` and `ended` are set by it."""

    def __init__(self, condition: Callable[[], bool] | None = None) -> None:
        self.begun, self.go_on, self.ended = (threading.Event() for _ in range(3))
        self._condition = condition or self.go_on.is_set

    def __call__(self) -> None:
        self.begun.set()
        until(self._condition)
        self.ended.set()


def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end
        threading.Event().wait(0.001)


def texts(runner: Runner) -> list[str]:
    return [m.text for m in runner.snapshot().messages]


def finish(runner: Runner) -> None:
    """Wait until the worker has done everything that was handed in before."""
    done = threading.Event()
    runner.submit(TaskKind.NOTE, "the last", done.set)
    assert done.wait(PATIENCE_S)
    until(lambda: not runner._waiting_jobs)


def test_a_finished_task_is_not_shown_as_running(make_session):
    """`submit` is delayed as it notes the beginning, until the task is done or 50 ms have passed."""
    done = threading.Event()

    def clock() -> float:
        if threading.current_thread() is threading.main_thread():
            done.wait(0.05)
        return time.monotonic()

    runner = Runner(make_session(short_procedure(3)), monotonic=clock)
    for k in range(3):
        done.clear()
        runner.submit(TaskKind.CONNECT, f"job {k}", done.set)
        assert done.wait(PATIENCE_S)
        finish(runner)
        assert runner.snapshot().task is None
    runner.close("end of the test")


def test_a_task_is_shown_before_it_begins_and_while_it_runs(runner):
    work = Task()
    runner.submit(TaskKind.CALIBRATE, "the first", work)
    assert work.begun.wait(PATIENCE_S)
    runner.submit(TaskKind.NOTE, "the second", lambda: None)
    task = runner.snapshot().task
    assert (task.kind, task.text) == (TaskKind.CALIBRATE, "the first")
    work.go_on.set()
    finish(runner)
    assert runner.snapshot().task is None


def test_a_connection_attempt_can_be_stopped_and_left(runner, monkeypatch):
    monkeypatch.setattr("operator_app.session.ui.runner.CONNECTION_ATTEMPT_S", 0.05)
    driver = Task()
    runner.submit(TaskKind.CONNECT, "connecting", driver)
    assert driver.begun.wait(PATIENCE_S)
    runner.close("end of the test")
    assert runner.connected
    driver.go_on.set()
    until(lambda: not runner.connected)


@pytest.mark.parametrize(
    ("ends", "done"),
    [(Runner.cancel, []), (Runner.send_quick_stop, ["connection"])],
)
def test_queued_tasks_are_dropped_after_an_ended_task_except_connecting(runner, ends, done):
    work, ran = Task(), list[str]()
    runner.submit(TaskKind.AUTOMATIC, "the first", work)
    runner.submit(TaskKind.MOVE, "a motion", lambda: ran.append("motion"))
    runner.submit(TaskKind.CONNECT, "a connection", lambda: ran.append("connection"))
    assert work.begun.wait(PATIENCE_S)
    ends(runner)
    assert runner.cancelled()
    work.go_on.set()
    finish(runner)
    assert (ran, any("a motion: cancelled" in text for text in texts(runner))) == (done, True)


def test_quick_stop_that_is_not_sent_is_shown(runner, arm, monkeypatch):
    monkeypatch.setattr(arm, "stop", Mock(side_effect=BusError("no adapter")))
    assert (runner.send_quick_stop(), runner.snapshot().stop.problem) == (False, "no adapter")


def test_host_latency_is_reported_once(runner, arm):
    arm.lateness = HostLatency(times=1, last_s=0.4, longest_s=0.4)
    until(lambda: any("late" in text for text in texts(runner)))
    threading.Event().wait(3 * WATCH_PERIOD_S)
    (message,) = (m for m in runner.snapshot().messages if "late" in m.text)
    assert message.level is Level.WARNING
    assert message.text.startswith("this computer was late by 0.4 s")


def test_a_stop_pressed_during_a_reset_is_not_reported_as_reset(runner, arm):
    reset = arm.reset_stop

    def reset_and_pressed_again() -> None:
        reset()
        arm.stop()

    arm.reset_stop = reset_and_pressed_again
    runner.stop()
    runner.submit(TaskKind.RESET, "resetting STOP", runner.operations.reset)
    finish(runner)
    assert runner.snapshot().stopped
    assert runner.snapshot().stop is not None
    assert not any("STOP reset" in text for text in texts(runner))
    arm.reset_stop = reset
    runner.submit(TaskKind.RESET, "resetting STOP", runner.operations.reset)
    finish(runner)
    assert runner.snapshot().stop is None
    assert texts(runner)[-1].startswith("STOP reset: ")
    runner.operations.reset()
    assert texts(runner)[-1].startswith("drive faults reset: ")


def test_an_unwatched_motion_is_ended(make_session):
    """A screen on a terminal that is no longer read accepts no key that stops."""
    now_s = [0.0]
    session = make_session(short_procedure(3))
    runner = Runner(session, monotonic=lambda: now_s[0])
    work = Task(runner.cancelled)
    runner.submit(TaskKind.MOVE, "moving", work)
    assert work.begun.wait(PATIENCE_S)
    # It continues while snapshots are read.
    for _ in range(3):
        runner.snapshot()
        now_s[0] += 0.9 * UNWATCHED_S
        assert not work.ended.wait(3 * WATCH_PERIOD_S)
    now_s[0] += 0.2 * UNWATCHED_S
    assert work.ended.wait(PATIENCE_S)
    until(lambda: any("the screen did not respond" in text for text in texts(runner)))
    runner.close("end of the test")


def test_a_crashed_thread_stops_the_arm_and_is_reported(source):
    def broken() -> str:
        raise ZeroDivisionError

    runner = source.new()
    runner.session.rig = replace(runner.session.rig, recording_ended=broken)
    until(lambda: isinstance(runner.defect, ZeroDivisionError))
    assert source.arm.stops
    runner.session.rig = replace(runner.session.rig, recording_ended=str)


def test_the_shown_plan_is_the_one_that_was_begun(runner, work):
    before = runner.snapshot().plan
    work.go(3)
    work.check_fixture()
    assert runner.snapshot().plan == before == waypoints_of(runner.session)
    assert runner.snapshot().at_waypoint == 3


@pytest.mark.campaign
def test_a_new_calibration_is_not_verified(runner, work):
    work.automatic()
    work.calibrate("implicit", ())
    work.verify(2)
    assert runner.snapshot().verification is not None
    work.calibrate("implicit", ())
    shown = runner.snapshot()
    assert (shown.verification, shown.written) == (None, None)
    assert shown.solution is not None


def test_held_joints_do_not_work_against_each_other(runner, work):
    work.hold()
    before = runner.session.arm.snapshot().positions_rad
    for moves in (lambda: work.go(0), work.wiggle, lambda: work.capture(0)):
        with pytest.raises(SessionError, match="7"):
            moves()
    assert abs(runner.session.arm.snapshot().positions_rad - before).max() < 0.02
    assert not runner.session.state.poses


def sensor_faults(runner: Runner) -> list[object]:
    return [fault["joint"] for fault in event_data(runner.session, "sensor_fault")]


@pytest.fixture
def stopped_by_itself(source, runner, work):
    """With a pose; a running calibration that ends only if cancelled delays the record of why the arm stopped."""
    calibrating = Task(runner.cancelled)
    work.capture(0)
    runner.submit(TaskKind.CALIBRATE, "calibrating", calibrating)
    assert calibrating.begun.wait(PATIENCE_S)
    source.arm.diverge(5)
    until(lambda: len(runner._waiting_jobs) > 1)
    until(lambda: any("oint 5" in a.text for a in runner.snapshot().alarms))
    return runner


def test_the_cause_of_a_stop_is_journalled_though_tasks_end(stopped_by_itself):
    runner = stopped_by_itself
    runner.stop()
    runner.submit(TaskKind.RESET, "resetting STOP", runner.operations.reset)
    finish(runner)
    assert not runner.snapshot().stopped
    assert "joint 5" in runner.session.state.sensor_jump
    assert (sensor_faults(runner), runner.session.state.used_poses) == ([5], ())


def test_the_cause_of_a_stop_is_journalled_though_the_session_closes(source, stopped_by_itself):
    source.close("end of the test")
    assert sensor_faults(stopped_by_itself) == [5]


def test_concurrent_tasks_run_in_order_and_can_be_ended(make_session):
    """The screen and the supervisor submit at the same time; a key must end the task that runs."""
    second = threading.Event()

    def clock() -> float:
        """Delay the submission of the first task."""
        if threading.current_thread() is first:
            second.wait(0.5)
        return time.monotonic()

    first = threading.Thread(target=lambda: runner.submit(TaskKind.MOVE, "the first", work))
    runner = Runner(make_session(short_procedure(3)), monotonic=clock)
    work = Task(runner.cancelled)
    first.start()
    until(lambda: len(runner._waiting_jobs) > 0)
    runner.submit(TaskKind.NOTE, "the second", second.set)
    first.join()
    assert work.begun.wait(PATIENCE_S)
    assert not second.is_set()
    runner.cancel()
    assert work.ended.wait(PATIENCE_S)
    runner.close("end of the test")


def test_resuming_marks_the_drive_joints_of_the_session(make_session):
    session = make_session(short_procedure(3), connect=True)
    assert session.procedure.position_joints == (1, 5)
    session.set_modes((1, 4))
    session.close("done")
    runner = Runner(make_session(short_procedure(3), resume=True))
    assert runner.snapshot().selected_joints == (1, 4)
    runner.close("end of the test")


def test_a_cancelled_task_is_shown_as_ending_at_once(runner):
    """One that is planning may take seconds until it ends."""
    task = Task()
    runner.submit(TaskKind.AUTOMATIC, "moving", task)
    assert task.begun.wait(PATIENCE_S)
    runner.operations.planning(active=True)
    assert runner.snapshot().task.progress == "planning the next poses; the arm stands still"
    runner.cancel()
    assert runner.snapshot().task.progress.startswith("ending: planning")
    task.go_on.set()
    finish(runner)
    assert runner.snapshot().task is None

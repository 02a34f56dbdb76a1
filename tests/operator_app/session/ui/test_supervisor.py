"""The supervisor: motion of the arm as shown, drives that do not obey STOP, and delays of this computer."""

import errno
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hardware.arm import ArmSnapshot, DriveState, HostLatency
from hardware.canopen.objects import EmergencyCode
from hardware.errors import DriveFault
from operator_app.composition import CutShort
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import JournalError
from operator_app.headless.console import ConsoleListener, cut_short_lines
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Level, SessionSnapshot
from operator_app.session.ui.supervisor import (
    LATENESS_INTERVAL_S,
    LatenessReporter,
    Motion,
    MotionMonitor,
    Supervisor,
)
from operator_app.session.workflow.drive_selection import visit
from solver.chain.sensors import NoSensor
from tests.oracles.journal_events import event_data
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.plant_arm import PlantArm
from tests.oracles.plant_sessions import short_procedure
from tests.oracles.still_runner import StaticRunner
from tests.oracles.story import stopped, story, unstopped, with_joints

PROCEDURE = load_procedure("hinge")
ALLOWED = np.array(PROCEDURE.capture.settle.spread_rad(PROCEDURE.arm))
HOME = np.full(PROCEDURE.arm.joint_count, 0.3)
AT_REST = PlantArm(PROCEDURE, "exact").snapshot()
SAMPLE_S = 0.05
SYNC_S = 0.01


def sample(k: int, q: np.ndarray) -> tuple[float, ArmSnapshot]:
    joints = tuple(
        replace(joint, position_rad=float(angle))
        for joint, angle in zip(AT_REST.joints, q, strict=True)
    )
    return k * SAMPLE_S, replace(AT_REST, sync_count=round(k * SAMPLE_S / SYNC_S), joints=joints)


def observed(*angles: np.ndarray) -> Motion:
    monitor = MotionMonitor(PROCEDURE.arm, PROCEDURE.capture)
    for k, q in enumerate(angles):
        motion = monitor.update(*sample(k, q))
    return motion


def test_a_steady_motion_has_its_speed_and_is_not_at_rest():
    speed = np.deg2rad([20.0, 0, 0, -3.0, 0, 0, 0])
    motion = observed(*(HOME + k * SAMPLE_S * speed for k in range(30)))
    assert motion.speed_rad_per_s == pytest.approx(speed, abs=1e-12)
    assert (motion.still, motion.held_s, motion.worst_joint) == (False, 0.0, 1)
    assert motion.sync_rate_hz == pytest.approx(100.0)


def test_sensor_noise_is_not_motion():
    sigma = np.array([joint.sensor.sigma_rad for joint in PROCEDURE.arm.joints])
    noise = np.random.default_rng(3).standard_normal((200, len(HOME))) * sigma
    motion = observed(*(HOME + noise))
    assert motion.still
    assert motion.held_s == pytest.approx(199 * SAMPLE_S)
    # 20 + 32 SYNC
    assert motion.needed_s == pytest.approx(0.52)
    # Eleven samples in half a second: the sum of squared times is 0.275 s^2.
    assert np.all(np.abs(motion.speed_rad_per_s) < 5.0 * sigma / np.sqrt(0.275))


def test_rest_begins_when_the_last_motion_left_the_window():
    steps = [0.0] * 20 + [0.01] + [0.02] * 20
    motion = observed(*(HOME + step for step in steps))
    assert motion.still
    # The window is 20 SYNC, four samples; the last movement was between samples 20 and 21.
    assert motion.held_s == pytest.approx((40 - 24) * SAMPLE_S)


def test_a_joint_beyond_its_limit_is_named():
    q = HOME.copy()
    q[2] += 2.0 * ALLOWED[2]
    motion = observed(HOME, HOME, q)
    assert (motion.still, motion.worst_joint) == (False, 3)
    assert motion.spread_share == pytest.approx(2.0)


def test_a_gap_in_the_data_resets_the_window():
    monitor = MotionMonitor(PROCEDURE.arm, PROCEDURE.capture)
    monitor.update(*sample(0, HOME))
    monitor.reset()
    motion = monitor.update(*sample(40, HOME + 0.3))
    assert (motion.still, motion.held_s) == (True, 0.0)
    assert not motion.speed_rad_per_s.any()


def test_an_unsensed_joint_is_ignored():
    procedure = load_procedure("hinge")
    joints = list(procedure.arm.joints)
    joints[6] = replace(joints[6], sensor=NoSensor())
    monitor = MotionMonitor(replace(procedure.arm, joints=tuple(joints)), procedure.capture)
    moved = HOME.copy()
    moved[6] += 1.0
    monitor.update(*sample(0, HOME))
    assert monitor.update(*sample(1, moved)).still


def supervised(picture: SessionSnapshot) -> tuple[StaticRunner, Supervisor]:
    runner = StaticRunner(picture)
    rig = SimpleNamespace(recording_ended=str)
    runner.session = SimpleNamespace(model=PROCEDURE.arm, procedure=PROCEDURE, rig=rig)
    return runner, Supervisor(runner, lambda: runner.picture.now_s)


def alarms_after(
    runner: StaticRunner, supervisor: Supervisor, by_s: float, *, age_s: float = 0.0
) -> list[str]:
    """Check the snapshot `by_s` later; joint 3's data are then `age_s` old. Return the alarms so far."""
    runner.picture = with_joints(
        runner.picture,
        lambda j: replace(j, age_s=age_s if j.joint == 3 else 0.0),
        now_s=runner.picture.now_s + by_s,
    )
    supervisor.check(runner.picture, unseen_s=0.0)
    return [m.text for m in runner.picture.messages if m.level is Level.ALARM]


def not_stopped(*joints: int) -> SessionSnapshot:
    picture = replace(unstopped(story()["capturing"]), messages=(), unstopped_joints=())
    drives = {True: DriveState.OPERATION_ENABLED, False: DriveState.QUICK_STOP_ACTIVE}
    return with_joints(picture, lambda j: replace(j, drive=drives[j.joint in joints]))


def test_drive_still_enabled_half_a_second_after_stop_is_an_alarm(approve):
    runner, supervisor = supervised(not_stopped(3))
    for by_s in (0.0, 0.3, 0.19):
        assert alarms_after(runner, supervisor, by_s) == []
    (alarm,) = alarms_after(runner, supervisor, 0.02)
    approve(alarm)
    assert runner.picture.unstopped_joints == (3,)
    assert alarms_after(runner, supervisor, 5.0) == [alarm], "once"
    runner.picture = stopped(runner.picture)
    alarms_after(runner, supervisor, 0.1)
    assert runner.picture.unstopped_joints == ()


def test_report_from_before_stop_is_no_alarm():
    runner, supervisor = supervised(not_stopped(3))
    alarms_after(runner, supervisor, 0.0)
    assert alarms_after(runner, supervisor, 0.8, age_s=0.4) == []
    assert len(alarms_after(runner, supervisor, 0.8, age_s=0.4)) == 1


def late(times: int, last_s: float, longest_s: float) -> HostLatency:
    return HostLatency(times=times, last_s=last_s, longest_s=longest_s)


def test_one_delay_is_one_message_and_a_series_one_per_interval(approve):
    text = LatenessReporter().new_text
    assert text(HostLatency(), 1000.0) == ""
    approve(text(late(1, 0.4, 0.4), 1000.1))
    assert text(late(1, 0.4, 0.4), 1000.2) == ""
    for k in range(2, 8):  # again and again, a second apart
        assert text(late(k, 0.5, 0.9), 1000.0 + k) == ""
    series = text(late(7, 0.5, 0.9), 1001.0 + LATENESS_INTERVAL_S)
    assert "late 6 times, the last time by 0.5 s:" in series
    assert text(late(7, 0.5, 0.9), 2000.0) == ""
    assert "late by 0.5 s:" in text(late(8, 0.5, 0.9), 2000.0)


@pytest.fixture
def busy(make_session):
    return make_session(short_procedure(40), connect=True)


def test_latency_is_in_the_journal_and_reported_at_the_next_pose(busy, capsys):
    listener = ConsoleListener()
    busy.take_control()
    busy.set_modes((1, 5))
    lateness = iter((late(0, 0.0, 0.0), late(1, 0.4, 0.4), late(1, 0.4, 0.4), late(3, 0.5, 0.9)))
    for waypoint, busy.arm.lateness in enumerate(lateness):
        assert visit(busy, waypoint)
        busy.capture(waypoint)
        listener.pose_captured(busy.state, 10)
    busy.arm.lateness = late(4, 2.0, 2.0)  # after the last pose
    busy.close("end of the test")
    journalled = [(data["times"], data["last_s"]) for data in event_data(busy, "late")]
    assert journalled == [(1, 0.4), (2, 0.5), (1, 2.0)]
    contents = read_journal(busy.journal.path.parent)
    assert session_state(contents).late == late(4, 2.0, 2.0)
    parts = capsys.readouterr().err.split("Warning: ")
    first, second = (part for part in parts if "this computer" in part)
    assert "late by 0.4 s" in first
    assert "late 2 times, the last time by 0.5 s" in second


@pytest.mark.parametrize(
    ("code", "times", "text"),
    [
        (EmergencyCode.HEARTBEAT_LOST, 1, "This computer was late by 0.83 s: the drives missed"),
        (EmergencyCode.HEARTBEAT_LOST, 3, "by 0.83 s (3 times, by 0.90 s at most)"),
        (EmergencyCode.HEARTBEAT_LOST, 0, ""),
        (EmergencyCode.FOLLOWING, 1, ""),
    ],
)
def test_a_run_ended_by_missed_heartbeats_reports_host_latency(busy, code, times, text):
    """No pose follows at which it could be reported."""
    busy.take_control()
    busy.set_modes((1, 5))
    busy.capture()
    if times:
        busy.arm.lateness = late(times, 0.83, 0.9 if times > 1 else 0.83)
    busy.close("failed")
    fault = DriveFault(1, code, "heartbeat or not")
    cut_short = CutShort(session=busy, cause=fault, connected=True, kept=True)
    lines = [line for line in cut_short_lines(cut_short) if "This computer was late" in line]
    assert len(lines) == bool(text)
    assert text in "".join(lines)


def test_latency_before_a_reconnect_is_journalled(busy):
    busy.arm.lateness = late(2, 0.4, 0.7)
    closed = busy.arm.closed
    Operations(busy, Quiet(busy)).connect()
    assert busy.arm.closed == closed + 1
    assert event_data(busy, "late") == [{"times": 2, "last_s": 0.4, "longest_s": 0.7}]


def test_the_arm_is_released_despite_full_disk_and_latency(busy, monkeypatch):
    busy.arm.lateness = late(1, 0.4, 0.4)

    def full(_descriptor: int, _data: bytes) -> int:
        raise OSError(errno.ENOSPC, "no space left on device")

    closed = busy.arm.closed
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(JournalError, match="no space"):
        busy.close("end of the test")
    assert busy.arm.closed == closed + 1
    assert busy.journal.closed

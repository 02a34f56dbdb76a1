"""Motion of the arm as shown to the operator: speed, rest and its limits. Drives that do not obey STOP."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hardware.arm import ArmSnapshot, DriveState
from operator_app.config.procedure_file import load_procedure
from operator_app.session.ui.snapshot import Level, SessionSnapshot
from operator_app.session.ui.supervisor import Motion, MotionMonitor, Supervisor
from solver.chain.sensors import NoSensor
from tests.oracles.plant_arm import PlantArm
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
    runner.session = SimpleNamespace(model=PROCEDURE.arm, procedure=PROCEDURE)
    return runner, Supervisor(runner, lambda: "", lambda: runner.picture.now_s)


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

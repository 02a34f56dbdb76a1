"""Faults of a capture: a stuck sensor, a count jump, an arm that cannot move, stops, or is outside its box."""

import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hardware.arm import ArmSnapshot, Fault, JointMode, MoveResult, Reading
from hardware.errors import DriveDiverged, SensorFault
from hardware.virtual.scenarios import scenario
from operator_app.config.procedure import Procedure
from operator_app.errors import Cancelled, ClosureRefusedError, GuardError, SessionError
from operator_app.session.ui.guards import may_remount
from operator_app.session.ui.runner import Runner
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import HOMING_SPEED_RAD_PER_S
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, begin
from operator_app.session.workflow.session import Session
from tests.oracles.journal_events import event_data
from tests.oracles.plant_arm import PlantArm
from tests.oracles.plant_sessions import (
    MakeSession,
    left_session,
    short_procedure,
    take_poses_until,
)


class FaultyArm(PlantArm):
    """The plant with a stuck sensor, a count jump or a stop, reported as the hardware reports them."""

    stuck_joint = 0
    jumps_at_capture = 0
    captures = 0
    overloaded = False
    stopped_by: SensorFault | None = None
    reported: tuple[Fault, ...] = ()
    _stuck_at: float | None = None

    def capture(self, samples: int) -> Reading:
        self.captures += 1
        if self.captures == self.jumps_at_capture:
            raise SensorFault(3, "jumped by +500 counts", since_sync=self._syncs)
        if self.stopped_by is not None:
            raise self.stopped_by
        reading = super().capture(samples)
        if not self.stuck_joint:
            return reading
        k = self.stuck_joint - 1
        if self._stuck_at is None:
            self._stuck_at = float(reading.mean_rad[k])
        mean, sd = reading.mean_rad.copy(), reading.sd_rad.copy()
        mean[k], sd[k] = self._stuck_at, 0.0
        return replace(reading, mean_rad=mean, sd_rad=sd)

    def snapshot(self) -> ArmSnapshot:
        snapshot = super().snapshot()
        cause = "" if self.stopped_by is None else str(self.stopped_by)
        joints = tuple(
            replace(j, torque_nm=95.0 if self.overloaded and j.joint == 2 else 0.0)
            for j in snapshot.joints
        )
        return replace(snapshot, joints=joints, stopped_for=cause, faults=self.reported)

    def move(self, targets_rad: Mapping[int, float], **options: Any) -> MoveResult:
        if self.overloaded:
            reason, q_rad = "joint 2 needed 95 N m", self._positions()
            return MoveResult(reached=False, reason=reason, positions_rad=q_rad, syncs=3)
        return super().move(targets_rad, **options)


def connected(make_session: MakeSession, scenario_name: str) -> Session:
    procedure = short_procedure(8, scenario_name)
    return make_session(procedure, arm=FaultyArm(procedure, scenario_name), connect=True)


@pytest.fixture
def session(make_session):
    session = connected(make_session, "datasheet")
    session.set_modes((1, 5))
    return session


@pytest.mark.parametrize(
    ("scenario_name", "joint"), [("datasheet", 3), ("datasheet", 6), ("exact", 7)]
)
def test_stuck_sensor_is_reported_and_its_pose_excluded(make_session, scenario_name, joint):
    session = connected(make_session, scenario_name)
    session.arm.stuck_joint = joint
    with pytest.raises(SensorFault, match=rf"joint {joint} reads the same count") as error:
        take_poses(session, Listener(), (1, 5))
    assert error.value.joint == joint
    assert "--unsensed" in str(error.value)
    assert len(session.state.poses) <= 3
    # The sensor may have been stuck at the last pose as well.
    assert "read wrong at that time" in session.state.poses[-1].excluded
    assert [fault["joint"] for fault in event_data(session, "sensor_fault")] == [joint]


def test_captures_after_a_jump_need_the_first_pose_repeated(session):
    session.arm.jumps_at_capture = 5  # the first capture is that of taking control
    with pytest.raises(SensorFault):
        take_poses(session, Listener(), (1, 5))
    captured = len(session.state.poses)
    assert session.state.sensor_jump
    with pytest.raises(GuardError, match="captures are refused: joint 3 jumped"):
        session.capture()
    assert len(session.state.poses) == captured

    # The first pose reads as before: the jump is over.
    take_poses_until(session, captured + 1)
    assert not session.state.sensor_jump
    assert session.state.repeats[-1].first.number == 1


def test_pose_captured_during_a_jump_is_excluded(session):
    session.capture()
    assert len(session.state.used_poses) == 1
    since_sync = session.arm.snapshot().sync_count - 3

    def report_jump(targets_rad: object, **_: object) -> MoveResult:
        raise SensorFault(4, "jumped", since_sync=since_sync)

    session.arm.move = report_jump
    with pytest.raises(SensorFault):
        session.go_to({1: 0.0})
    assert session.state.used_poses == ()
    assert "joint 4 read wrong at that time" in session.state.poses[0].excluded


def test_upload_after_a_sensor_fault_needs_the_first_pose_repeated(session):
    take_poses(session, Listener(), (1, 5))
    session.require_counters_of_poses()
    session.arm.jumps_at_capture = session.arm.captures + 1
    with pytest.raises(SensorFault):
        session.take_check_reading("verification")
    session.take_check_reading("verification")  # does not show whether the first pose is unchanged
    with pytest.raises(GuardError, match="upload is refused: joint 3 jumped"):
        session.require_counters_of_poses()

    take_poses(session, Listener())
    session.require_counters_of_poses()


def test_repaired_sensor_needs_the_first_pose_repeated(session):
    take_poses(session, Listener(), (1, 5))
    failed = Fault(node=3, joint=3, code=0x7305, text="angle sensor failed", sync_count=9)
    session.arm.reported = (failed,)
    runner = Runner(session)
    runner.operations.reset()
    assert "angle sensor failed" in may_remount(runner.snapshot())
    runner.close("end")
    with pytest.raises(GuardError, match="captures are refused: joint 3: angle sensor failed"):
        session.capture()
    assert [fault["joint"] for fault in event_data(session, "sensor_fault")] == [3]


def test_upload_after_a_lost_connection_compares_the_readings_with_the_poses(session):
    take_poses(session, Listener(), (1, 5))
    session.release_holding()
    session.connect()
    session.require_counters_of_poses()
    session.release_holding()
    session.connect()
    session.arm.off_rad[2] = 0.3  # its drive has restarted
    with pytest.raises(ClosureRefusedError, match="loop does not close"):
        session.require_counters_of_poses()


def test_arm_that_cannot_start_to_move_skips_no_waypoint(session):
    session.arm.overloaded = True
    with pytest.raises(GuardError, match=r"cannot start to move: joint 2 needed 95 N m"):
        take_poses(session, Listener())
    assert session.state.visited == frozenset()
    session.arm.overloaded = False
    take_poses_until(session, 2)
    assert {p.waypoint for p in session.state.poses} == {0, 1}


def test_skipped_waypoint_is_tried_again_after_a_resume(session, make_session):
    session.record("waypoint_skipped", {"waypoint": 0, "reason": "joint 2 needed 95 N m"})
    assert session.state.next_waypoint == 1
    session.close("left")
    assert make_session(session.procedure, resume=True).state.next_waypoint == 0


@pytest.mark.parametrize("poses", [10**6, 10**30])
def test_too_many_poses_are_refused(tmp_path, poses):
    with pytest.raises(SessionError, match="at most 100000"):
        begin("hinge", Choices(poses=poses), root=tmp_path)


def stop_after_pose(session: Session) -> DriveDiverged:
    session.capture()
    since_sync = session.arm.snapshot().sync_count - 3
    session.arm.stopped_by = DriveDiverged(5, 1300, since_sync=since_sync)
    return session.arm.stopped_by


def test_stop_cause_is_journalled_once_and_its_pose_excluded(session):
    record_stop_cause = session.reader.sensor_faults.record_stop_cause
    record_stop_cause()
    cause = stop_after_pose(session)
    for request in (record_stop_cause, record_stop_cause, session.reader.read):
        with pytest.raises(DriveDiverged):
            request()
    assert event_data(session, "sensor_fault") == [{"joint": 5, "text": str(cause)}]
    assert "joint 5 read wrong at that time" in session.state.poses[0].excluded
    assert session.state.sensor_jump


@pytest.mark.parametrize(
    "clear",
    [Session.reset_stop, Session.release_holding, lambda session: session.close("left")],
    ids=["reset", "reconnect", "close"],
)
def test_stop_cause_is_journalled_before_the_arm_clears_it(session, clear):
    """The operator may press the key before the supervisor looks."""
    stop_after_pose(session)
    clear(session)
    assert [fault["joint"] for fault in event_data(session, "sensor_fault")] == [5]
    assert session.state.sensor_jump
    assert session.state.used_poses == ()


POSES = 6
DATASHEET = scenario("datasheet", seed=3)
OUTSIDE_RAD = float(np.deg2rad(102.5))
"""Of joint 1, whose box ends at 88.5 deg."""


def arm_outside_box(procedure: Procedure) -> PlantArm:
    """The plant with joint 1 moved out of its box before the session."""
    arm = PlantArm(procedure, DATASHEET)
    arm.take_control()
    arm.set_modes([JointMode.POSITION if j in (1, 5) else JointMode.FREE for j in range(1, 8)])
    arm.move({1: OUTSIDE_RAD}, speed_rad_per_s=0.5)
    arm.settle(window=20, spread_rad=[1e-3] * 7, timeout_syncs=500)
    arm.take_control()
    arm.moves.clear()
    assert arm.snapshot().positions_rad[0] == pytest.approx(OUTSIDE_RAD, abs=np.deg2rad(0.1))
    return arm


def case_procedure(case: str) -> Procedure:
    """The procedure of a case; `planned` explores round home, `complete` has all its poses after a session."""
    packaged = "hinge_planned" if case == "planned" else "hinge"
    poses = 40 if case == "incomplete" else POSES
    procedure = short_procedure(poses, "datasheet", packaged=packaged, seed=3)
    return replace(procedure, position_joints=(1, 5))


@pytest.fixture(scope="module")
def session_folder(tmp_path_factory):
    @cache
    def make(case: str) -> Path:
        procedure, poses = case_procedure(case), 3 if case == "planned" else POSES
        folder = tmp_path_factory.mktemp(case) / "s"
        return left_session(folder, PlantArm(procedure, DATASHEET), procedure, poses)

    return make


@pytest.fixture
def resumed(session_folder, make_session, tmp_path, case, undone):
    procedure = case_procedure(case)
    shutil.copytree(session_folder(case), tmp_path / "session")
    session = make_session(procedure, arm=arm_outside_box(procedure), resume=True, connect=True)
    if undone:
        session.undo()
    return session


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("case", "undone"),
    [("incomplete", False), ("complete", False), ("planned", True), ("planned", False)],
    ids=["incomplete", "complete", "new plan", "planned"],
)
def test_resume_moves_only_with_agreement_and_then_home_slowly_first(resumed):
    def measured() -> tuple[int, int]:
        return len(resumed.state.repeats), len(resumed.state.poses)

    before = measured()
    for _ in range(2):
        with pytest.raises(GuardError, match=r"joint 1 is at \+102\.\d+ deg, outside") as error:
            take_poses(resumed, Listener(), (1, 5))
        assert "--go-home" in error.value.remedy
        assert resumed.arm.moves == []
        assert measured() == before
    resumed.cancelled = lambda: measured() != before
    with suppress(Cancelled):
        take_poses(resumed, Listener(), (1, 5), homing=True)
    assert measured() != before
    speeds = [speed for _, speed in resumed.arm.moves]
    assert speeds[0] == HOMING_SPEED_RAD_PER_S
    assert len(speeds) > 1

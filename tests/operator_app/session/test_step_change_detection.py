"""A step change of a driven joint is detected at the next pose, which leads to a repeat of the first pose."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.virtual.axis import PlantReading
from hardware.virtual.scenarios import scenario
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prior import LEAST, is_unpredicted
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled, GuardError
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Level
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import visit
from operator_app.session.workflow.session import Session
from solver.chain.poses import PoseSet
from tests.oracles.as_shipped import poses_of
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.plant_arm import PlantArm
from tests.oracles.plant_sessions import RecordingListener
from tests.oracles.shop_floor import Sizes, session

COUNT_RAD = 2.0 * np.pi / 400_000
DEGREE_COUNTS = 1111
PLANNED = LEAST + 2
"""Poses of a planned capture after which a step of a degree is detected at the next one."""
AS_REPORTED = Sizes(length_m=1.5e-3, give_m=1e-3, give_rad=2e-3)


def is_detected(
    poses: PoseSet,
    count: int,
    joint: int = 1,
    step_counts: int = 0,
    *,
    unsensed: tuple[int, ...] = (),
) -> bool:
    procedure = load_procedure("hinge")
    poses = poses.at_poses(np.arange(count))
    q_rad = poses.q_rad.copy()
    q_rad[-1, joint - 1] += step_counts * COUNT_RAD
    poses = replace(poses, q_rad=q_rad)
    return is_unpredicted(
        Experiment(
            arm=procedure.arm, fixture=procedure.fixture.fixture, poses=poses, unsensed=unsensed
        )
    )


@pytest.mark.sample(1)
@pytest.mark.parametrize("sizes", [Sizes(), AS_REPORTED], ids=["stated", "as reported"])
def test_no_step_is_detected_on_a_sound_arm(sizes):
    """Generated arms; of 200 complete sessions none had one (three kinds of arms)."""
    for seed in range(2):
        poses = poses_of(session(seed, sizes))
        assert not any(is_detected(poses, count) for count in range(LEAST, 41, 5))
    # Too few poses detect no step.
    poses = poses_of(session(0))
    assert not is_detected(poses, LEAST, 1, 5 * DEGREE_COUNTS)
    assert is_detected(poses, LEAST + 1, 1, 5 * DEGREE_COUNTS)


@pytest.mark.sample(1)
@pytest.mark.parametrize("joint", [1, 2, 3, 4])
def test_step_of_a_degree_is_detected_at_the_next_pose(joint):
    for seed, step_counts in ((0, -DEGREE_COUNTS), (1, DEGREE_COUNTS)):
        poses = poses_of(session(seed))
        for count in (LEAST + 1, 20, 40):
            assert is_detected(poses, count, joint, step_counts)


def test_step_is_detected_without_the_readings_of_the_wrist():
    poses = poses_of(session(0))
    assert not is_detected(poses, 20, unsensed=(6, 7))
    assert is_detected(poses, 20, 1, DEGREE_COUNTS, unsensed=(6, 7))


class CountLossArm(PlantArm):
    """The plant with an encoder of joint 1 that loses counts, so that its drive moves the joint by as many."""

    def __init__(self, procedure: Procedure) -> None:
        self.lost_counts = np.zeros(procedure.arm.joint_count, dtype=int)
        super().__init__(procedure, scenario("datasheet", seed=3))

    def _step(self) -> PlantReading:
        targets = self._targets
        self._targets = targets - self.lost_counts * self._resolution
        try:
            reading = super()._step()
        finally:
            self._targets = targets
        counts = np.array(reading.position_counts) + self.lost_counts
        self._reading = replace(reading, position_counts=tuple(counts.tolist()))
        return self._reading


@pytest.fixture
def begin(make_session):
    """Begin a session with a count loss after some poses, `steps` by their numbers; cancelled after `most` poses."""

    def make(
        most: int, steps: dict[int, int], name: str = "hinge"
    ) -> tuple[Session, RecordingListener]:
        procedure = load_procedure(name)
        capture = replace(procedure.capture, samples_per_pose=8)
        procedure = replace(procedure, capture=capture, position_joints=(1, 5))
        arm = CountLossArm(procedure)
        session = make_session(procedure, arm=arm, connect=True)
        session.cancelled = lambda: len(session.state.poses) == most

        def lose_counts(count: int) -> None:
            arm.lost_counts[0] += steps.get(count, 0)

        return session, RecordingListener(lose_counts)

    return make


PROCEDURES = pytest.mark.parametrize(
    ("name", "after"),
    [("hinge", 14), pytest.param("hinge_planned", PLANNED, marks=pytest.mark.campaign)],
)


@PROCEDURES
def test_step_of_a_driven_joint_is_reported_at_the_next_pose(begin, name, after):
    """A planned capture repeats its first pose as long as the step has not led to another plan.

    The poses before pose 11 predict it to a degree only: a step after it is detected at pose 12.
    """
    session, listener = begin(after + 2, {after: DEGREE_COUNTS}, name)
    with pytest.raises(GuardError, match="joint 1 has shifted by") as error:
        take_poses(session, listener, (1, 5))
    assert "start a new session" in str(error.value)
    assert session.state.poses[-1].planned is (name == "hinge_planned")
    assert len(session.state.poses) == after + 1
    assert f"Pose {after + 1} does not fit" in " ".join(listener.said)


def test_sound_arm_repeats_no_pose(begin):
    session, listener = begin(16, {})
    with pytest.raises(Cancelled):
        take_poses(session, listener, (1, 5))
    assert session.state.readings == ()
    assert listener.said == []


@PROCEDURES
def test_single_outlier_costs_one_repeat_only(begin, name, after):
    """The counts are back before the first pose is repeated."""
    steps = {after: DEGREE_COUNTS, after + 1: -DEGREE_COUNTS}
    session, listener = begin(after + 3, steps, name)
    with pytest.raises(Cancelled):
        take_poses(session, listener, (1, 5))
    assert len(session.state.poses) == after + 3
    assert [r.again.after for r in session.state.repeats] == [after + 1]
    assert any("outlier" in text and f" {after + 1} " in text for text in listener.said)


def test_step_between_manual_poses_warns_and_automatic_capture_repeats(begin, approve):
    session, listener = begin(20, {LEAST: DEGREE_COUNTS})
    publisher = Quiet(session)
    operations = Operations(session, publisher)
    session.set_modes((1, 5))
    for waypoint in range(LEAST + 1):
        assert visit(session, waypoint)
        operations.capture(waypoint)
        listener.pose_captured(session.state, 40)
    (warning,) = (text for level, text in publisher.said if level is Level.WARNING)
    approve(warning)
    assert session.state.readings == ()
    with pytest.raises(GuardError, match="joint 1 has shifted by"):
        take_poses(session, listener)
    assert len(session.state.poses) == LEAST + 1

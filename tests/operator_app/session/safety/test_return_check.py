"""Repeats of the first pose: at the end, after a resume, after a pose that does not fit; what a step leads to."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.base import RIGID
from hardware.virtual.axis import PlantReading
from hardware.virtual.scenarios import scenario
from operator_app.calibration.acceptance import Verdict, not_yet_named, proven_by_return
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prior import LEAST, is_unpredicted
from operator_app.calibration.repeat_measurement import compare_readings
from operator_app.calibration.result import Solution
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled, GuardError
from operator_app.messages.finding import Finding
from operator_app.messages.finding import FindingKind as Kind
from operator_app.session.store.stored_calibration import NO_WAY_BACK, missing_repeat_notices
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Level
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import visit
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.planned_capture import PlannedCapture
from operator_app.session.workflow.session import Session
from solver.chain.poses import PoseSet
from solver.diagnostics.hypothesis_tests import HypothesisTest
from tests.oracles.as_shipped import poses_of
from tests.oracles.journal_events import journal_events
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.plant_arm import PlantArm
from tests.oracles.plant_sessions import RecordingListener, short_procedure, take_poses_until
from tests.oracles.shop_floor import Sizes, session


def test_capture_ends_with_a_repeat_of_the_first_pose(make_session):
    session = make_session(short_procedure(6), connect=True)
    listener = RecordingListener()
    take_poses(session, listener, (1, 5))
    # A check that finds nothing states its result too.
    assert "Pose 1 measured again agrees with its first reading (chi2 " in listener.reports[-1]
    (repeat,) = session.state.repeats
    assert (repeat.first.number, repeat.again.kind, repeat.again.after) == (1, "return", 6)
    assert len(session.state.used_poses) == 6
    # The arm is not exactly there, but on the motions that the loop allows.
    solution = session.calibrate()
    reread = session.state.rereads[-1]
    difference = compare_readings(session.model, solution.model, solution.estimate.x, reread, RIGID)
    assert np.abs(difference.difference_rad).max() > np.deg2rad(0.005)
    assert difference.dof == 5
    assert difference.chi2 < 0.1
    # A second request measures nothing more.
    take_poses(session, Listener())
    assert len(session.state.readings) == 1


def test_repeat_that_cannot_disagree_is_no_evidence(make_session):
    # Without the readings of three joints, any readings of the other four belong to a closed chain.
    procedure = replace(short_procedure(12), unsensed_joints=(3, 4, 5))
    session = make_session(procedure, connect=True)
    listener = RecordingListener()
    take_poses(session, listener, (1, 5))
    assert not any("differs" in text for text in listener.reports)
    solution = session.calibrate()
    loop = session.fixture.model(session.model, unsensed_joints=(3, 4, 5))
    (reread,) = session.state.rereads
    assert compare_readings(session.model, loop, solution.estimate.x, reread, RIGID) is None
    assert not any("RETURN" in cause.code for cause in solution.causes)


def test_resumed_session_repeats_the_first_pose_before_new_ones(make_session):
    session = make_session(short_procedure(5), connect=True)
    take_poses_until(session, 2)
    session.close("left")
    assert not session.state.repeats

    resumed = make_session(short_procedure(5), resume=True, connect=True)
    take_poses(resumed, Listener(), (1, 5))
    names = [e.name for e in journal_events(resumed)]
    measured = [n for n in names[names.index("resumed") :] if n in ("reading", "pose")]
    assert measured == ["reading", "pose", "pose", "pose", "reading"]
    assert [r.again.after for r in resumed.state.repeats] == [2, 5]
    assert {r.first.number for r in resumed.state.repeats} == {1}
    # An excluded pose has no repeats.
    resumed.exclude(1, "bumped")
    assert resumed.state.repeats == ()


def test_unreachable_first_pose_is_reported_and_the_capture_complete(make_session):
    session = make_session(short_procedure(4), connect=True)

    def narrow_range_of_joint_7(count: int) -> None:
        if count == 4:
            *others, last = session.model.joints
            q_rad = session.arm.snapshot().positions_rad[6]
            last = replace(last, lower_rad=q_rad - 0.04, upper_rad=q_rad + 0.04)
            session.model = replace(session.model, joints=(*others, last))

    listener = RecordingListener(narrow_range_of_joint_7)
    take_poses(session, listener, (1, 5))
    assert len(session.state.used_poses) == 4
    assert session.state.repeats == ()
    assert "joint 7" in listener.reports[-1]
    assert journal_events(session)[-1].name == "return_missed"
    (notice,) = missing_repeat_notices(session.state)
    assert notice.code == "NO_RETURN"
    assert notice.poses == ("1", "1", "4")
    assert notice.reported[0].startswith("joint 7")


def test_capture_ended_early_warns_of_the_missing_repeat(make_session):
    session = make_session(short_procedure(7), connect=True)
    take_poses_until(session, 6)
    session.cancelled = lambda: False
    (notice,) = (w for w in session.calibrate().warnings if w.code == "NO_RETURN")
    assert notice.poses == ("1", "1", "6")
    assert notice.kind is Kind.NOT_REPEATED
    take_poses(session, Listener(), (1, 5))
    assert missing_repeat_notices(session.state) == ()
    assert "NO_RETURN" not in {w.code for w in session.calibrate().warnings}


def test_missing_path_back_requires_verification_not_a_resume(make_session):
    """A planned capture without a path back has none after a resume either."""
    session = make_session(short_procedure(4), connect=True)
    session.set_modes((1, 5))
    for k in range(4):
        visit(session, k)
        session.capture(k)
    missed, path = PlannedCapture(session, (1, 5), Listener()).to_first()
    assert (missed, list(path)) == (NO_WAY_BACK, [])
    session.record("return_missed", {"of": 1, "reason": missed})
    (notice,) = missing_repeat_notices(session.state)
    assert notice.reported == (NO_WAY_BACK,)
    assert notice.kind is Kind.NEVER_REPEATED
    # Another cause may be gone after a resume.
    session.record("return_missed", {"of": 1, "reason": "joint 3 needed 95 N m"})
    (notice,) = missing_repeat_notices(session.state)
    assert notice.kind is Kind.NOT_REPEATED


def calibrate_with_step(
    session: Session, *, step_rad: float = 0.0, joint: int = 3, after: int | None = None
) -> Solution:
    """Calibrate from all poses, a joint's reading shifted after one of them, by default before the return."""

    def shift_reading(count: int) -> None:
        if count == (after or session.procedure.capture.poses):
            session.arm.off_rad[joint - 1] = step_rad

    session.connect()
    take_poses(session, RecordingListener(shift_reading), (1, 5))
    return session.calibrate()


def return_test(solution: Solution) -> HypothesisTest:
    (test,) = (t for t in solution.adjudication.tests if t.code.startswith("RETURN"))
    return test


def return_causes(solution: Solution) -> list[str]:
    return [c.code for c in solution.causes if c.code.startswith("RETURN")]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["exact", "datasheet"])
def test_sound_session_has_no_cause_from_its_return(make_session, name):
    """Another return after the calibration requires a new calibration."""
    session = make_session(short_procedure(20, name, samples=32), name)
    solution = calibrate_with_step(session)
    test = return_test(solution)
    assert test.code == "RETURN_20"
    assert 0.0 < test.statistic < test.threshold
    assert return_causes(solution) == []
    assert solution.accepted
    assert session.recorded_calibration() is not None
    session.take_check_reading("return", of=session.state.used_poses[0].number)
    assert session.recorded_calibration() is None


@pytest.mark.sample(2)
@pytest.mark.parametrize("joint", [2, 3, 5, 7])
@pytest.mark.parametrize("name", ["exact", "datasheet"])
def test_step_before_the_return_is_reported_with_joint_and_size(make_session, name, joint):
    session = make_session(short_procedure(20, name, samples=32), name)
    solution = calibrate_with_step(session, step_rad=np.deg2rad(0.5), joint=joint)
    assert return_test(solution).fires
    assert return_causes(solution) == [f"RETURN_JOINT_{joint}"]
    assert solution.verdict is Verdict.NOT_ACCEPTED
    (cause,) = (c for c in solution.causes if c.code == f"RETURN_JOINT_{joint}")
    assert cause.blocking
    assert cause.probability > 0.9
    assert cause.size == pytest.approx(np.deg2rad(0.5), abs=3.0 * cause.sigma + 2e-5)
    assert (cause.poses, cause.figures["after"]) == (("1",), 20)


@pytest.mark.campaign
def test_compliant_fixture_is_not_reported_as_a_joint_step(make_session):
    procedure = short_procedure(20, "as_reported", samples=32)
    solution = calibrate_with_step(make_session(procedure, "as_reported"))
    assert return_test(solution).fires
    assert not [code for code in return_causes(solution) if code.startswith("RETURN_JOINT")]
    assert any("fixture" in c.text for c in solution.causes)
    assert solution.verdict is not Verdict.ACCEPTED


@pytest.mark.parametrize(
    ("from_poses", "from_return", "reported"),
    [
        (Kind.LENGTH_OFF, Kind.REPEAT_READING_STEP, True),
        (Kind.FIXTURE_DEFLECTS_MORE, Kind.REPEAT_FIXTURE_MOVED, True),
        (Kind.READING_STEP, Kind.REPEAT_READING_STEP, False),
        (Kind.FIXTURE_SLIPPED, Kind.REPEAT_FIXTURE_MOVED, False),
    ],
)
def test_return_reports_only_steps_that_the_poses_do_not_show(from_poses, from_return, reported):
    def finding(kind: Kind) -> Finding:
        return Finding(kind=kind, joint=3, names=("s_3",), blocking=True)

    new = not_yet_named((finding(from_return),), (finding(from_poses),))
    assert new == (finding(from_return),) * reported


def test_step_proven_by_the_return_blocks_acceptance():
    step = Finding(kind=Kind.READING_STEP, joint=1)
    length = Finding(kind=Kind.LENGTH_OFF, names=("s_3",))
    returned = Finding(kind=Kind.REPEAT_READING_STEP, joint=1, blocking=True)
    blocking_step = replace(step, blocking=True)
    assert proven_by_return((returned,), (length, step)) == ((blocking_step,), (length,))
    other = replace(returned, joint=2)
    assert proven_by_return((other,), (length, step)) == ((other,), (length, step))
    assert proven_by_return((replace(other, blocking=False),), (step,)) == ((), (step,))


def test_step_among_few_poses_is_refused_because_of_the_return(make_session):
    """With seven poses the step makes the sigmas so large that no parameter is off by two of them."""
    session = make_session(short_procedure(7, "datasheet"), "datasheet")
    solution = calibrate_with_step(session, step_rad=-np.deg2rad(0.45), joint=1, after=4)
    assert return_test(solution).fires
    assert solution.verdict is Verdict.NOT_ACCEPTED
    assert solution.causes[0].code in {"STEP_JOINT_1", "RETURN_JOINT_1"}
    assert solution.causes[0].blocking


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
        self._reading = reading._replace(position_counts=tuple(counts.tolist()))
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
    assert f"Pose {after + 1} does not fit" in " ".join(listener.reports)
    # A second attempt measures the first pose again, and goes on only if that agrees.
    with pytest.raises(GuardError, match="joint 1 has shifted by"):
        take_poses(session, listener, (1, 5))
    assert len(session.state.poses) == after + 1


@PROCEDURES
def test_single_outlier_costs_one_repeat_only(begin, name, after):
    """The counts are back before the first pose is repeated."""
    steps = {after: DEGREE_COUNTS, after + 1: -DEGREE_COUNTS}
    session, listener = begin(after + 3, steps, name)
    with pytest.raises(Cancelled):
        take_poses(session, listener, (1, 5))
    assert len(session.state.poses) == after + 3
    assert [r.again.after for r in session.state.repeats] == [after + 1]
    assert any("outlier" in text and f" {after + 1} " in text for text in listener.reports)


def test_step_between_manual_poses_warns_and_automatic_capture_repeats(begin, approve):
    session, listener = begin(20, {LEAST: DEGREE_COUNTS})
    publisher = Quiet(session)
    operations = Operations(session, publisher)
    session.set_modes((1, 5))
    for waypoint in range(LEAST + 1):
        assert visit(session, waypoint)
        operations.capture(waypoint)
        listener.pose_captured(session.state, 40)
    (warning,) = (text for level, text in publisher.messages if level is Level.WARNING)
    approve(warning)
    assert session.state.readings == ()
    with pytest.raises(GuardError, match="joint 1 has shifted by"):
        take_poses(session, listener)
    assert len(session.state.poses) == LEAST + 1

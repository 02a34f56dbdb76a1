"""The session on the real plant without a bus: guards, complete runs, interruption and resuming."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.commands.run import run
from operator_app.config.parameters_file import load_parameters
from operator_app.config.poses_file import load_poses
from operator_app.errors import GuardError
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.snapshot import Level
from operator_app.session.workflow.capture import connect, verify
from operator_app.session.workflow.drive_selection import waypoints_of
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from solver.chain.arm_model import ArmModel
from solver.errors import TooFewPosesError
from tests.oracles.journal_events import event_data, journal_events
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.plant_sessions import RecordingListener, short_procedure

PDO = "joint 1 (node 1): RPDO2 is 6040h(16) + 607Ah(32) on 301h; it was 6040h(16) on 301h"
ZEROED = "joint 2 (node 2): 6071h is 0; it was -50"


@pytest.mark.parametrize(
    ("identity", "level"),
    [
        pytest.param({"configured": (PDO, PDO)}, Level.INFO, id="PDOs"),
        pytest.param({"configured": (PDO, ZEROED), "zeroed": (ZEROED,)}, Level.INFO, id="zeroed"),
        pytest.param({"unwatching": (3, 5)}, Level.WARNING, id="no heartbeat timeout"),
    ],
)
def test_changed_drive_settings_are_reported_and_journalled(make_session, identity, level, approve):
    session = make_session(short_procedure(12))
    connect_arm = session.arm.connect
    session.arm.connect = lambda: replace(connect_arm(), **identity)
    listener, publisher = RecordingListener(), Quiet(session)
    connect(session, listener)
    approve(listener.reports[1])
    Operations(session, publisher).connect()
    assert (level, listener.reports[1].removesuffix(".")) in publisher.messages
    journalled = [data.get("configured", []) for data in event_data(session, "connected")]
    assert journalled == [list(identity.get("configured", ()))] * 2


def test_run_reports_each_pose_and_uploads_the_parameters_of_its_poses(make_session):
    session = make_session(short_procedure(20))
    listener = RecordingListener()
    result = run(session, listener)
    assert listener.counts == list(range(1, 21))
    document = load_parameters(result.exported.parameters)
    assert document.arm.serial == "SDA-0001"
    poses = load_poses(result.exported.parameters.parent / "poses.csv", joint_count=7).poses
    assert len(poses) == 20
    assert document.pose_set_sha256 == session.state.pose_set().sha256() == poses.sha256()
    assert session.arm.active_parameters() == result.exported.parameters.read_bytes()


@pytest.mark.parametrize("joints", [(), (1,), (1, 2, 5)])
def test_wrong_number_of_drive_joints_is_refused(make_session, joints, approve):
    session = make_session(short_procedure(3), connect=True)
    with pytest.raises(GuardError) as error:
        session.set_modes(joints)
    approve(str(error.value))
    assert session.state.modes == ()


def test_unknown_joint_missing_modes_and_too_few_poses_are_refused(make_session):
    session = make_session(short_procedure(2))
    with pytest.raises(GuardError, match="no joint 8"):
        session.check_modes((1, 8))
    with pytest.raises(GuardError, match="modes are not set"):
        waypoints_of(session)
    with pytest.raises(TooFewPosesError, match="at least 3 poses"):
        run(session, Listener())


@pytest.mark.sample(2)
@pytest.mark.parametrize("sync", [3, 40, 333, 500, 900])
def test_interrupted_session_resumes_without_loss_of_poses(make_session, sync):
    session = make_session(short_procedure(6))
    session.arm.interrupt_at_sync = sync  # type: ignore[attr-defined]
    with pytest.raises(KeyboardInterrupt):
        run(session, Listener())
    session.arm.interrupt_at_sync = None  # type: ignore[attr-defined]
    session.close("interrupted")
    session.close("again")
    poses_before = session.state.poses

    resumed = make_session(short_procedure(6), resume=True)
    assert [p.number for p in resumed.state.poses] == [p.number for p in poses_before]
    assert run(resumed, Listener()).solution.accepted
    assert [p.number for p in resumed.state.used_poses] == list(range(1, 7))
    assert [p.waypoint for p in resumed.state.used_poses] == list(range(6))
    for before, after in zip(poses_before, resumed.state.poses, strict=False):
        np.testing.assert_array_equal(before.mean_rad, after.mean_rad)


def test_resuming_with_another_arm_is_refused(make_session):
    make_session(short_procedure(3), connect=True).close("done")
    resumed = make_session(short_procedure(3), resume=True, serial="SDA-0002")
    with pytest.raises(GuardError, match="belongs to arm SDA-0001"):
        resumed.connect()


def test_undo_exclude_include_and_note_survive_a_resume(make_session):
    session = make_session(short_procedure(5))
    run(session, Listener())
    assert session.undo().number == 5
    session.exclude(2, "bumped the table")
    session.note(3, "after lunch")
    session.exclude(4, "")
    session.include(4)
    with pytest.raises(GuardError, match="no pose 5"):
        session.exclude(5, "")
    expected = [(1, "", ""), (2, "bumped the table", ""), (3, "", "after lunch"), (4, "", "")]
    assert [(p.number, p.excluded, p.note) for p in session.state.poses] == expected
    assert session.state.solved == {}
    session.close("done")
    resumed = make_session(short_procedure(5), resume=True)
    assert [(p.number, p.excluded, p.note) for p in resumed.state.poses] == expected
    run(resumed, Listener())
    assert [p.number for p in resumed.state.used_poses] == [1, 3, 4, 6, 7]


def with_range(arm: ArmModel, lower_rad: float, upper_rad: float) -> ArmModel:
    last = replace(arm.joints[6], lower_rad=lower_rad, upper_rad=upper_rad)
    return replace(arm, joints=(*arm.joints[:6], last))


def test_unreachable_waypoint_is_skipped_and_journalled(make_session):
    procedure = short_procedure(4)
    # The range of joint 7 ends inside the planned region.
    limit = float(np.deg2rad(10.0))
    arm = with_range(procedure.arm, limit, procedure.arm.joints[6].upper_rad)
    session = make_session(replace(procedure, arm=arm))
    run(session, Listener())
    assert "joint 7" in event_data(session, "waypoint_skipped")[0]["reason"]
    assert len(session.state.used_poses) == 4
    assert all(p.mean_rad[6] > limit for p in session.state.poses)


def run_headless(session: Session) -> None:
    run(session, Listener())


def run_in_app(session: Session) -> None:
    operations = Operations(session, Quiet(session))
    operations.connect()
    operations.set_modes((1, 5))
    operations.automatic()


@pytest.mark.parametrize("run_session", [run_headless, run_in_app])
def test_unreachable_poses_have_one_message_in_all_interfaces(make_session, run_session, approve):
    session = make_session(short_procedure(3))
    # In both directions from home joint 7 reaches an end of its range.
    home, margin = session.arm.snapshot().positions_rad[6], np.deg2rad(2.5)
    session.model = with_range(session.model, home - margin, home + margin)
    reason = "3 poses could be reached; the last skipped waypoint was skipped because joint 7 came"
    with pytest.raises(GuardError, match=reason) as error:
        run_session(session)
    approve(error.value.remedy)


def test_verification_poses_are_journalled_apart_from_the_calibration(make_session):
    session = make_session(short_procedure(8))
    result = run(session, Listener())
    session.set_modes((1, 5))
    before = session.state
    for count in (1, 2):
        verdict, poses = verify(session, result.solution, 3, Listener())
        assert verdict.poses == len(poses) == 3
        assert session.state.verifications == count
    session.close("done")

    state = make_session(short_procedure(8), resume=True).state
    readings = state.readings[1:]
    assert [(r.kind, r.number) for r in readings] == [("verification", k) for k in range(2, 8)]
    np.testing.assert_array_equal([r.mean_rad for r in readings[3:]], poses.q_rad)
    # They differ from the session's poses and from each other.
    q_rad = np.array([p.mean_rad for p in (*state.poses, *readings)])
    distances = np.abs(q_rad[:, None] - q_rad).max(axis=-1) + np.eye(len(q_rad))
    assert distances.min() > np.deg2rad(0.2)
    assert state.pose_set().sha256() == before.pose_set().sha256()
    assert state.visited == before.visited
    verified = event_data(session, "verified")
    assert [v["readings"] for v in verified] == [[2, 3, 4], [5, 6, 7]]
    assert verified[1]["position_m"] == verdict.verification.sigmas.position_m.rms


def test_resumed_session_uses_the_journalled_solution_in_all_interfaces(make_session):
    session = make_session(short_procedure(5))
    solution = run(session, Listener()).solution
    session.close("done")

    resumed = make_session(short_procedure(5), resume=True)
    publisher = Quiet(resumed)
    Operations(resumed, publisher).connect()
    np.testing.assert_array_equal(publisher.shown.solution.estimate.x, solution.estimate.x)
    resumed.close("left")

    resumed = make_session(short_procedure(5), resume=True)
    result = run(resumed, Listener())
    np.testing.assert_array_equal(result.solution.estimate.x, solution.estimate.x)
    resumed.close("done")
    names = [e.name for e in journal_events(session)]
    # No pose was missing: nothing was measured or solved again.
    assert names.count("solved") == names.count("checked") == names.count("reading") == 1
    # Another estimator or other poses need another solution.
    other = make_session(replace(short_procedure(5), estimator="paper"), resume=True)
    assert other.recorded_calibration() is None
    x = other.calibrate(estimator="implicit", unsensed_joints=(6,)).estimate.x
    other.close("left")
    runner = Runner(make_session(short_procedure(5), resume=True))
    runner.operations.connect()
    assert runner.snapshot().unsensed_joints == (6,)
    np.testing.assert_array_equal(runner.snapshot().solution.estimate.x, x)
    runner.session.exclude(2, "bumped")
    assert not runner.session.state.solved
    runner.close("left")

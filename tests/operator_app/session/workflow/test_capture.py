"""The session on the real plant without a bus: guards, the whole way, interruption and resuming."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.rigid import Rigid
from hardware.virtual.true_loop import paper_loop
from operator_app.calibration.closed_loops import FixtureRefusedError
from operator_app.config.fixture_file import load_fixture
from operator_app.config.parameters_file import load_parameters
from operator_app.config.poses_file import load_poses
from operator_app.errors import GuardError
from operator_app.headless.procedure_run import run
from operator_app.session.store.journal import read_journal
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Level
from operator_app.session.workflow.capture import connect, verify
from operator_app.session.workflow.drive_selection import waypoints_of
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from solver.chain.arm_model import ArmModel
from solver.errors import TooFewPosesError
from solver.loops.dh import DhLoop
from tests.oracles.hearing import Hearing
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.short_procedure import short_procedure

PDO = "joint 1 (node 1): RPDO2 is 6040h(16) + 607Ah(32) on 301h; it was 6040h(16) on 301h"
ZEROED = "joint 2 (node 2): 6071h is 0; it was -50"


@pytest.mark.parametrize(
    ("found", "level"),
    [
        pytest.param({"configured": (PDO, PDO)}, Level.INFO, id="PDOs"),
        pytest.param({"configured": (PDO, ZEROED), "zeroed": (ZEROED,)}, Level.INFO, id="zeroed"),
        pytest.param({"unwatching": (3, 5)}, Level.WARNING, id="no heartbeat timeout"),
    ],
)
def test_what_is_found_in_drives_is_said_on_every_interface_and_journalled(
    make_session, found, level, approve
):
    session = make_session(short_procedure(12))
    connect_arm = session.arm.connect
    session.arm.connect = lambda: replace(connect_arm(), **found)
    hearing, publisher = Hearing(), Quiet(session)
    connect(session, hearing)
    approve(hearing.said[0])
    Operations(session, publisher).connect()
    assert (level, hearing.said[0].removesuffix(".")) in publisher.said
    lines = [e for e in read_journal(session.journal.path.parent).events if e.name == "connected"]
    configured = list(found.get("configured", ()))
    assert [configured] * 2 == [line.data.get("configured", []) for line in lines]


def truth(model: DhLoop) -> np.ndarray:
    table = paper_loop().table.stacked()
    return np.array([table[e.kind, e.row] for e in model.entries])


def test_the_whole_way_recovers_the_arm(make_session):
    session = make_session(short_procedure(20))
    listener = Hearing()
    result = run(session, listener)

    assert listener.heard == list(range(1, 21))
    estimate = result.solution.estimate
    assert isinstance(result.solution.model, DhLoop)
    error = np.abs(estimate.x - truth(result.solution.model))
    # The parameters' own standard deviations, from count^2/12: five of them is the bound.
    assert np.all(error < 5.0 * estimate.standard_deviation)
    assert error.max() < 5e-5

    assert result.exported is not None
    document = load_parameters(result.exported.parameters)
    assert document.arm.serial == "SDA-0001"
    poses = load_poses(result.exported.poses, joint_count=7).poses
    assert len(poses) == 20
    assert document.pose_set_sha256 == session.state.pose_set().sha256() == poses.sha256()
    assert session.arm.active_parameters() == result.exported.parameters.read_bytes()


@pytest.mark.parametrize("joints", [(), (1,), (1, 2, 5)])
def test_a_wrong_number_of_drive_joints_is_refused_with_the_reason(make_session, joints, approve):
    session = make_session(short_procedure(3), connect=True)
    with pytest.raises(GuardError) as refused:
        session.set_modes(joints)
    approve(str(refused.value))
    assert refused.value.remedy == "put exactly 2 in position mode"
    assert session.state.modes == ()


def test_a_joint_that_is_not_there_is_named(make_session):
    session = make_session(short_procedure(3))
    with pytest.raises(GuardError, match="no joint 8"):
        session.check_modes((1, 8))


def test_rigid_names_the_elbow_before_anything_moves(make_session):
    procedure = short_procedure(3)
    fixture = load_fixture("rigid")
    assert isinstance(fixture.fixture, Rigid)
    session = make_session(replace(procedure, fixture=fixture, position_joints=(1,)), connect=True)
    with pytest.raises(FixtureRefusedError, match="joint 4 does not move"):
        session.require_fixture()
    assert session.state.modes == ()


def test_capture_before_modes_is_refused(make_session):
    session = make_session(short_procedure(3))
    with pytest.raises(GuardError, match="modes are not set"):
        waypoints_of(session)


def test_two_poses_are_too_few_and_it_says_how_many_are_needed(make_session):
    session = make_session(short_procedure(2))
    with pytest.raises(TooFewPosesError, match="at least 3 poses"):
        run(session, Listener())


@pytest.mark.sample(2)
@pytest.mark.parametrize("sync", [3, 40, 333, 500, 900])
def test_interrupted_anywhere_it_resumes_with_no_accepted_pose_lost(make_session, sync):
    session = make_session(short_procedure(6))
    session.arm.interrupt_at_sync = sync  # type: ignore[attr-defined]
    with pytest.raises(KeyboardInterrupt):
        run(session, Listener())
    session.arm.interrupt_at_sync = None  # type: ignore[attr-defined]
    session.close("interrupted")
    session.close("again")
    kept = session.state.poses

    again = make_session(short_procedure(6), resume=True)
    assert [p.number for p in again.state.poses] == [p.number for p in kept]
    result = run(again, Listener())
    assert result.solution.accepted
    assert [p.number for p in again.state.used_poses] == list(range(1, 7))
    assert [p.waypoint for p in again.state.used_poses] == list(range(6))
    for before, after in zip(kept, again.state.poses, strict=False):
        np.testing.assert_array_equal(before.mean_rad, after.mean_rad)


def test_a_session_insists_on_its_arm(make_session):
    session = make_session(short_procedure(3), connect=True)
    session.close("done")
    other = make_session(short_procedure(3), resume=True, serial="SDA-0002")
    with pytest.raises(GuardError, match="belongs to arm SDA-0001"):
        other.connect()


def test_undo_exclude_include_and_note_survive_a_restart(make_session):
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
    again = make_session(short_procedure(5), resume=True)
    assert [(p.number, p.excluded, p.note) for p in again.state.poses] == expected
    run(again, Listener())
    assert [p.number for p in again.state.used_poses] == [1, 3, 4, 6, 7]


def with_range(arm: ArmModel, lower_rad: float, upper_rad: float) -> ArmModel:
    """The arm with another range of joint 7."""
    last = replace(arm.joints[6], lower_rad=lower_rad, upper_rad=upper_rad)
    return replace(arm, joints=(*arm.joints[:6], last))


def test_an_unreachable_waypoint_is_passed_over_and_recorded(make_session):
    procedure = short_procedure(4)
    # Joint 7's range now ends inside the region the plan wants to explore.
    limit = float(np.deg2rad(10.0))
    arm = with_range(procedure.arm, limit, procedure.arm.joints[6].upper_rad)
    session = make_session(replace(procedure, arm=arm))
    run(session, Listener())
    events = read_journal(session.journal.path.parent).events
    skipped = [e.data for e in events if e.name == "waypoint_skipped"]
    assert skipped
    assert "joint 7" in skipped[0]["reason"]
    assert len(session.state.used_poses) == 4
    assert all(p.mean_rad[6] > limit for p in session.state.poses)


def by_command(session: Session) -> None:
    run(session, Listener())


def on_screen(session: Session) -> None:
    """As the terminal app and plain mode do it."""
    work = Operations(session, Quiet(session))
    work.connect()
    work.set_modes((1, 5))
    work.automatic()


@pytest.mark.parametrize("face", [by_command, on_screen])
def test_poses_out_of_reach_end_in_the_same_words_whichever_face_asked(make_session, face, approve):
    session = make_session(short_procedure(3))
    # Whichever way joint 7 turns from home it comes to an end of its range.
    here, margin = session.arm.snapshot().positions_rad[6], np.deg2rad(2.5)
    session.model = with_range(session.model, here - margin, here + margin)
    with pytest.raises(GuardError, match="of 3 poses could be reached") as refused:
        face(session)
    approve(refused.value.remedy)


def test_verification_poses_are_in_the_journal_and_no_part_of_the_calibration(make_session):
    session = make_session(short_procedure(8))
    result = run(session, Listener())
    session.set_modes((1, 5))
    before = session.state
    for again in range(2):
        verdict, poses = verify(session, result.solution, 3, Listener())
        assert verdict.poses == len(poses) == 3
        assert session.state.verifications == again + 1
    session.close("done")

    state = make_session(short_procedure(8), resume=True).state
    taken = state.readings[1:]
    assert [(r.kind, r.number) for r in taken] == [("verification", k) for k in range(2, 8)]
    np.testing.assert_array_equal([r.mean_rad for r in taken[3:]], poses.q_rad)
    # Elsewhere than the session's poses, and elsewhere each time.
    everywhere = np.array([p.mean_rad for p in (*state.poses, *taken)])
    apart = np.abs(everywhere[:, None] - everywhere).max(axis=-1) + np.eye(len(everywhere))
    assert apart.min() > np.deg2rad(0.2)
    assert state.pose_set().sha256() == before.pose_set().sha256()
    assert state.visited == before.visited
    events = read_journal(session.journal.path.parent).events
    verified = [e.data for e in events if e.name == "verified"]
    assert [v["readings"] for v in verified] == [[2, 3, 4], [5, 6, 7]]
    assert verified[1]["position_m"] == verdict.verification.sigmas.position_m.rms


def test_a_resumed_session_is_not_solved_again_whichever_face_resumes_it(make_session):
    session = make_session(short_procedure(5))
    solution = run(session, Listener()).solution
    session.close("done")

    again = make_session(short_procedure(5), resume=True)
    publisher = Quiet(again)
    Operations(again, publisher).connect()
    assert publisher.shown.solution is not None
    np.testing.assert_array_equal(publisher.shown.solution.estimate.x, solution.estimate.x)
    again.close("left")

    last = make_session(short_procedure(5), resume=True)
    result = run(last, Listener())
    np.testing.assert_array_equal(result.solution.estimate.x, solution.estimate.x)
    last.close("done")
    names = [e.name for e in read_journal(session.journal.path.parent).events]
    # Nothing was left to take: nothing was read, and there was nothing new to solve.
    assert names.count("solved") == names.count("checked") == names.count("reading") == 1
    # Asked to solve otherwise, it does.
    other = make_session(replace(short_procedure(5), estimator="paper"), resume=True)
    assert other.recorded_calibration() is None
    # Of other poses nothing is known.
    other.exclude(2, "bumped")
    assert not other.state.solved

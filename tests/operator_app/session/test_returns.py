"""A session comes back to its first pose, at the end and after every resume, and says what slipped."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.base import RIGID
from hardware.arm import Reading
from operator_app.calibration.acceptance import Verdict, not_yet_named, proven_by_return
from operator_app.calibration.repeat_measurement import Repeat, compare_readings
from operator_app.calibration.result import Solution
from operator_app.messages.finding import Finding
from operator_app.messages.finding import FindingKind as Kind
from operator_app.session.store.journal import read_journal
from operator_app.session.store.stored_calibration import NO_WAY_BACK, missing_repeat_notices
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import visit
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.planned_capture import PlannedCapture
from operator_app.session.workflow.session import Session
from solver.diagnostics import hypothesis_tests
from tests.oracles.hearing import Hearing, take_until
from tests.oracles.short_procedure import short_procedure


def slipping(session: Session, joint: int, slip_rad: float) -> Hearing:
    """After the last pose one joint counts otherwise."""

    def slip(count: int) -> None:
        if count == session.procedure.capture.poses:
            session.arm.off_rad[joint - 1] = slip_rad

    return Hearing(slip)


def judged(session: Session) -> Repeat:
    """The last return, by the calibration of the same session."""
    solution = session.calibrate()
    last = session.state.rereads[-1]
    return compare_readings(session.model, solution.model, solution.estimate.x, last, RIGID)


def test_it_ends_where_it_began(make_session):
    session = make_session(short_procedure(6), connect=True)
    take_poses(session, Listener(), (1, 5))
    (found,) = session.state.repeats
    assert (found.first.number, found.again.kind, found.again.after) == (1, "return", 6)
    assert len(session.state.used_poses) == 6
    # Not exactly there, but along the chain's own motions.
    repeat = judged(session)
    assert np.abs(repeat.difference_rad).max() > np.deg2rad(0.005)
    assert repeat.dof == 5
    assert repeat.chi2 < 0.1
    assert repeat.chi2_left < repeat.chi2
    # Asked for again, there is nothing left to do.
    take_poses(session, Listener())
    assert len(session.state.readings) == 1


def test_after_a_resume_it_looks_at_its_first_pose_before_it_goes_on(make_session):
    session = make_session(short_procedure(5), connect=True)
    take_until(session, 2)
    session.close("left")
    assert not session.state.repeats

    again = make_session(short_procedure(5), resume=True, connect=True)
    take_poses(again, Listener(), (1, 5))
    names = [e.name for e in read_journal(again.journal.path.parent).events]
    after = [n for n in names[names.index("resumed") :] if n in ("reading", "pose")]
    assert after == ["reading", "pose", "pose", "pose", "reading"]
    assert [r.again.after for r in again.state.repeats] == [2, 5]
    assert {r.first.number for r in again.state.repeats} == {1}
    # A first pose that is withdrawn is no first pose any more.
    again.exclude(1, "bumped")
    assert again.state.repeats == ()


def test_a_first_pose_out_of_reach_is_said_and_the_capture_is_whole(make_session):
    def narrow(count: int) -> None:
        if count == 4:
            *others, last = session.model.joints
            here = session.arm.snapshot().positions_rad[6]
            last = replace(last, lower_rad=here - 0.04, upper_rad=here + 0.04)
            session.model = replace(session.model, joints=(*others, last))

    hearing = Hearing(narrow)
    session = make_session(short_procedure(4), connect=True)
    take_poses(session, hearing, (1, 5))
    assert len(session.state.used_poses) == 4
    assert session.state.repeats == ()
    assert "joint 7" in hearing.said[-1]
    assert read_journal(session.journal.path.parent).events[-1].name == "return_missed"
    (notice,) = missing_repeat_notices(session.state)
    assert notice.code == "NO_RETURN"
    assert notice.poses == ("1", "1", "4")
    assert notice.reported[0].startswith("joint 7")


def test_a_capture_that_ended_early_says_what_was_not_tested_until_it_has_been(make_session):
    session = make_session(short_procedure(7), connect=True)
    take_until(session, 6)
    session.cancelled = lambda: False
    (notice,) = (w for w in session.calibrate().warnings if w.code == "NO_RETURN")
    assert notice.poses == ("1", "1", "6")
    assert notice.kind is Kind.NOT_REPEATED
    take_poses(session, Listener(), (1, 5))
    assert missing_repeat_notices(session.state) == ()
    assert "NO_RETURN" not in {w.code for w in session.calibrate().warnings}


def test_where_no_way_leads_back_it_is_to_be_verified_and_not_to_be_resumed(make_session):
    """A planned capture that knows no way back knows none after a resume either."""
    session = make_session(short_procedure(4), connect=True)
    session.set_modes((1, 5))
    for k in range(4):
        visit(session, k)
        session.capture(k)
    planned = PlannedCapture(session, (1, 5), Listener())
    missed, way = planned.to_first()
    assert (missed, list(way)) == (NO_WAY_BACK, [])
    session.record("return_missed", {"of": 1, "reason": missed})
    (notice,) = missing_repeat_notices(session.state)
    assert notice.reported == (NO_WAY_BACK,)
    assert notice.kind is Kind.NEVER_REPEATED
    # What only was in the way may be gone.
    session.record("return_missed", {"of": 1, "reason": "joint 3 needed 95 N m"})
    (notice,) = missing_repeat_notices(session.state)
    assert notice.kind is Kind.NOT_REPEATED


def sessioned(session: Session, *, slip_rad: float = 0.0, joint: int = 3) -> Solution:
    """Take all poses, let a joint slip before the arm is back, and calibrate."""
    session.connect()
    take_poses(session, slipping(session, joint, slip_rad), (1, 5))
    return session.calibrate()


def return_test(solution: Solution) -> hypothesis_tests.HypothesisTest:
    (found,) = (t for t in solution.adjudication.tests if t.code.startswith("RETURN"))
    return found


def returns_of(solution: Solution) -> list[str]:
    return [c.code for c in solution.causes if c.code.startswith("RETURN")]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["exact", "datasheet"])
def test_a_sound_session_says_nothing_of_its_return_but_the_figure(make_session, name):
    solution = sessioned(make_session(short_procedure(20, name, samples=32), name))
    test = return_test(solution)
    assert test.code == "RETURN_20"
    assert 0.0 < test.statistic < test.threshold
    assert returns_of(solution) == []
    assert solution.accepted


@pytest.mark.sample(2)
@pytest.mark.parametrize("joint", [2, 3, 5, 7])
@pytest.mark.parametrize("name", ["exact", "datasheet"])
def test_a_joint_that_slipped_before_the_return_is_named_with_its_size_and_refused(
    make_session, name, joint
):
    session = make_session(short_procedure(20, name, samples=32), name)
    solution = sessioned(session, slip_rad=np.deg2rad(0.5), joint=joint)
    assert return_test(solution).fires
    assert returns_of(solution) == [f"RETURN_JOINT_{joint}"]
    assert solution.verdict is Verdict.NOT_ACCEPTED
    (cause,) = (c for c in solution.causes if c.code == f"RETURN_JOINT_{joint}")
    assert cause.blocking
    assert cause.probability > 0.9
    assert cause.size == pytest.approx(np.deg2rad(0.5), abs=3.0 * cause.sigma + 2e-5)
    assert (cause.poses, cause.figures["after"]) == (("1",), 20)


@pytest.mark.campaign
def test_a_fixture_that_bends_is_no_encoder_that_slipped(make_session):
    solution = sessioned(
        make_session(short_procedure(20, "as_reported", samples=32), "as_reported")
    )
    assert return_test(solution).fires
    assert not [code for code in returns_of(solution) if code.startswith("RETURN_JOINT")]
    assert any("fixture" in c.text for c in solution.causes)
    assert solution.verdict is not Verdict.ACCEPTED


def test_a_return_after_a_calibration_asks_for_another(make_session):
    session = make_session(short_procedure(20, "exact", samples=32))
    sessioned(session)
    assert session.recorded_calibration() is not None
    session.take_check_reading("return", of=session.state.used_poses[0].number)
    assert session.recorded_calibration() is None


@pytest.mark.parametrize(
    ("named", "since", "kept"),
    [
        (Kind.LENGTH_OFF, Kind.REPEAT_READING_STEP, True),
        (Kind.FIXTURE_DEFLECTS_MORE, Kind.REPEAT_FIXTURE_MOVED, True),
        (Kind.READING_STEP, Kind.REPEAT_READING_STEP, False),
        (Kind.FIXTURE_SLIPPED, Kind.REPEAT_FIXTURE_MOVED, False),
    ],
)
def test_only_the_same_slip_makes_a_return_say_nothing_new(named, since, kept):
    def cause(kind: Kind) -> Finding:
        return Finding(kind=kind, joint=3, names=("s_3",), blocking=True)

    assert not_yet_named((cause(since),), (cause(named),)) == (cause(since),) * kept


def test_a_slip_that_a_return_proves_refuses_whatever_the_poses_said_of_it():
    step = Finding(kind=Kind.READING_STEP, joint=1)
    length = Finding(kind=Kind.LENGTH_OFF, names=("s_3",))
    returned = Finding(kind=Kind.REPEAT_READING_STEP, joint=1, blocking=True)
    assert proven_by_return((returned,), (length, step)) == (
        (replace(step, blocking=True),),
        (length,),
    )
    other = replace(returned, joint=2)
    assert proven_by_return((other,), (length, step)) == ((other,), (length, step))
    assert proven_by_return((replace(other, blocking=False),), (step,)) == ((), (step,))


def test_few_poses_with_a_slip_in_mid_session_that_the_return_proves_are_refused(make_session):
    """Seven poses: the slip makes sigmas so wide that no parameter is off by two of them."""
    session = make_session(short_procedure(7, "datasheet"), "datasheet", connect=True)
    whole = session.arm.capture

    def slipped(samples: int) -> Reading:
        found = whole(samples)
        mean = found.mean_rad.copy()
        mean[0] -= np.deg2rad(0.45)
        return replace(found, mean_rad=mean)

    def slip(count: int) -> None:
        if count == 4:
            session.arm.capture = slipped

    take_poses(session, Hearing(slip), (1, 5))
    solution = session.calibrate()
    assert return_test(solution).fires
    assert solution.verdict is Verdict.NOT_ACCEPTED
    assert solution.causes[0].code in {"STEP_JOINT_1", "RETURN_JOINT_1"}
    assert solution.causes[0].blocking

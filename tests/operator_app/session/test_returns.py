"""A session comes back to its first pose, at the end and after every resume, and says what slipped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hardware.arm import Reading
from hardware.virtual.scenarios import scenario
from operator_app.calibration.repeats import Repeat, compare_readings
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled
from operator_app.session.journal import read_journal
from operator_app.session.listener import Listener
from operator_app.session.session import Session
from operator_app.session.workflow import take_poses

MakeSession = Callable[..., Session]


def exact_procedure(poses: int) -> Procedure:
    """The packaged hinge procedure with few poses, for the arm that scenario `exact` carries."""
    procedure = load_procedure("hinge")
    capture = replace(procedure.capture, poses=poses, samples_per_pose=8)
    return replace(procedure, arm=scenario("exact").arm(procedure.arm), capture=capture)


def begun(session: Session) -> Session:
    session.connect()
    return session


def judged(session: Session) -> Repeat:
    """The last return, by the calibration of the same session."""
    solution = session.calibrate()
    found = session.state.returns[-1]
    return compare_readings(
        session.model,
        solution.model,
        solution.estimate.x,
        found.first.mean_rad,
        found.again.mean_rad,
        samples=found.again.samples,
    )


def test_it_ends_where_it_began(make_session: MakeSession) -> None:
    session = begun(make_session(exact_procedure(6)))
    take_poses(session, Listener(), (1, 5))
    (found,) = session.state.returns
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


@pytest.mark.parametrize("joint", [2, 5, 7])
def test_a_joint_that_slipped_in_between_is_named_with_its_size(
    make_session: MakeSession, joint: int
) -> None:
    slip = np.deg2rad(0.2)

    class Slipping(Listener):
        """After the last pose one joint counts otherwise."""

        def pose_captured(self, state: object, wanted: int) -> None:
            if len(session.state.poses) == 6:
                session.arm.capture = slipped

    session = begun(make_session(exact_procedure(6)))
    whole = session.arm.capture

    def slipped(samples: int) -> Reading:
        found = whole(samples)
        mean = found.mean_rad.copy()
        mean[joint - 1] += slip
        return replace(found, mean_rad=mean)

    take_poses(session, Slipping(), (1, 5))
    repeat = judged(session)
    assert repeat.joint == joint
    # A joint that little else depends on (5) is seen at a third of the others' weight.
    assert repeat.chi2 > 25.0
    assert repeat.size_rad == pytest.approx(slip, abs=3.0 * repeat.sigma_rad)
    assert repeat.sigma_rad < np.deg2rad(0.05)
    assert repeat.chi2_left < 5.0


def test_after_a_resume_it_looks_at_its_first_pose_before_it_goes_on(
    make_session: MakeSession,
) -> None:
    session = begun(make_session(exact_procedure(5)))
    session.cancelled = lambda: len(session.state.poses) == 2
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5))
    session.close("left")
    assert not session.state.returns

    again = begun(make_session(exact_procedure(5), resume=True))
    take_poses(again, Listener(), (1, 5))
    names = [e.name for e in read_journal(again.journal.path.parent).events]
    after = [n for n in names[names.index("resumed") :] if n in ("reading", "pose")]
    assert after == ["reading", "pose", "pose", "pose", "reading"]
    assert [r.again.after for r in again.state.returns] == [2, 5]
    assert {r.first.number for r in again.state.returns} == {1}
    # A first pose that is withdrawn is no first pose any more.
    again.exclude(1, "bumped")
    assert again.state.returns == ()


def test_a_first_pose_out_of_reach_is_said_and_the_capture_is_whole(
    make_session: MakeSession,
) -> None:
    said: list[str] = []

    class Hearing(Listener):
        def told(self, text: str) -> None:
            said.append(text)

        def pose_captured(self, state: object, wanted: int) -> None:
            if len(session.state.poses) == 4:
                joints = list(session.model.joints)
                here = session.arm.snapshot().positions_rad[6]
                joints[6] = replace(joints[6], lower_rad=here - 0.04, upper_rad=here + 0.04)
                session.model = replace(session.model, joints=tuple(joints))

    session = begun(make_session(exact_procedure(4)))
    take_poses(session, Hearing(), (1, 5))
    assert len(session.state.used_poses) == 4
    assert session.state.returns == ()
    assert said[-1].startswith("Pose 1 could not be read once more: joint 7")
    assert read_journal(session.journal.path.parent).events[-1].name == "return_missed"

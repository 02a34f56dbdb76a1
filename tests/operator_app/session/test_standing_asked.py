"""A session asks before it enables a drive whether what the joints read may be true, and keeps the answer."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.base import Tolerance
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import GuardError
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from tests.oracles.hearing import take_until
from tests.oracles.opened import MakeSession
from tests.oracles.wrong_zero import WrongZero


def procedure_of(poses: int = 2) -> Procedure:
    procedure = load_procedure("hinge")
    return replace(procedure, capture=replace(procedure.capture, poses=poses, samples_per_pose=8))


def refused(
    make_session: MakeSession, arm: WrongZero, *, homing: bool, resume: bool = False
) -> str:
    """Why a session is refused, before any drive is enabled or moved."""
    session = make_session(procedure_of(40 if resume else 2), arm=arm, resume=resume, connect=True)
    arm.enabled = 0
    arm.moves.clear()
    with pytest.raises(GuardError) as found:
        take_poses(session, Listener(), (1, 5), homing=homing)
    assert (arm.enabled, arm.moves) == (0, [])
    # The plant's own end holds it as well.
    session.close("refused")
    return str(found.value)


def off(joint: int, degrees: float) -> Callable[[WrongZero], None]:
    return lambda arm: arm.off_rad.__setitem__(joint - 1, np.deg2rad(degrees))


def counter_reset(joint: int) -> Callable[[WrongZero], None]:
    return lambda arm: arm.reset_counter(joint)


def turned_round(arm: WrongZero) -> None:
    arm.off_rad[1] = -2.0 * arm.snapshot().positions_rad[1]


def exchanged(arm: WrongZero) -> None:
    q = arm.snapshot().positions_rad
    arm.off_rad[[1, 2]] = q[[2, 1]] - q[[1, 2]]


OPEN = "the loop cannot close with the present joint readings"


@pytest.mark.parametrize("homing", [False, True])
@pytest.mark.parametrize(
    ("harm", "parts"),
    [
        (counter_reset(1), ("the counter of joint 1 is at zero", "Home joint 1")),
        (off(1, -60.0), (OPEN, "it closes with joint 1 near")),
        (off(2, 60.0), (OPEN, "it closes with joint 2 near")),
        (off(3, 60.0), (OPEN, "it closes with joint 3 near")),
        (off(4, -60.0), (OPEN, "it closes with joint 4 near")),
        (turned_round, ("it closes with joint 2 near", "direction")),
        (exchanged, ("ignoring any one joint's reading does not help", "order of the joints")),
    ],
    ids=["reset 1", "off 1", "off 2", "off 3", "off 4", "direction", "exchanged"],
)
def test_what_a_joint_cannot_read_is_named_and_nothing_is_enabled_whoever_agrees(
    make_session, harm, parts, homing
):
    arm = WrongZero(procedure_of())
    harm(arm)
    said = refused(make_session, arm, homing=homing)
    assert all(part in said for part in parts), said
    assert "go-home" not in said


def left_after(make_session: MakeSession, poses: int) -> WrongZero:
    """The arm of a session that was left after so many poses; it stands where it took the last."""
    procedure = procedure_of(40)
    arm = WrongZero(procedure)
    session = make_session(procedure, arm=arm, connect=True)
    if poses:
        take_until(session, poses)
    session.close("left")
    # It comes to rest before anybody looks again.
    arm.capture(500)
    return arm


@pytest.mark.sample(4)
@pytest.mark.parametrize("poses", [1, 2])
@pytest.mark.parametrize(
    ("harm", "said"),
    [
        pytest.param(off(joint, degrees), OPEN, id=f"off {joint} by {degrees:+.0f} deg")
        for joint in (1, 2, 3, 4)
        for degrees in (-60.0, 60.0)
    ]
    + [pytest.param(counter_reset(1), "the counter of joint 1 is at zero", id="reset 1")],
)
def test_with_too_few_poses_to_tell_it_is_named_all_the_same(make_session, poses, harm, said):
    arm = left_after(make_session, poses)
    harm(arm)
    assert said in refused(make_session, arm, homing=True, resume=True)


def test_a_sound_arm_with_too_few_poses_to_tell_goes_on(make_session):
    arm = left_after(make_session, 2)
    session = make_session(procedure_of(40), arm=arm, resume=True, connect=True)
    take_until(session, 3)
    assert len(session.state.poses) == 3


def standings(folder: Path) -> list[dict[str, object]]:
    return [dict(e.data) for e in read_journal(folder).events if e.name == "standing"]


@pytest.mark.sample(1)
@pytest.mark.parametrize("poses", [0, 1, 20])
def test_why_it_was_refused_is_in_the_journal_and_that_it_passed(make_session, tmp_path, poses):
    folder, arm = tmp_path / "session", left_after(make_session, poses)
    before = standings(folder)
    if poses:
        # The files alone let it pass before the first pose.
        (passed,) = before
        assert passed["refused"] is False
        assert 1e-12 < float(str(passed["probability"])) <= 1.0
        assert "within the tolerances of the files" in str(passed["told"])
    off(2, 60.0)(arm)
    said = refused(make_session, arm, homing=True, resume=True)
    *_, last = found = standings(folder)
    # With one pose: that it is too few to tell, then what the files say.
    assert len(found) == len(before) + (2 if poses == 1 else 1)
    assert last["refused"] is True
    assert str(last["told"]) in said
    assert float(str(last["probability"])) < 1e-4
    # Whoever reads the journal takes it.
    assert session_state(read_journal(folder)).captured == poses


def test_a_counter_out_of_its_range_is_in_the_journal_as_well(make_session, tmp_path):
    arm = WrongZero(procedure_of())
    arm.reset_counter(2)
    said = refused(make_session, arm, homing=False)
    (last,) = standings(tmp_path / "session")
    assert (last["refused"], last["probability"]) == (True, None)
    assert str(last["told"]) in said


def test_where_the_files_say_too_little_no_agreement_drives_a_counter_at_zero(make_session):
    """The loop tells nothing then; the box of the procedure still knows that zero is outside."""
    vague = Tolerance(position_m=1.0, orientation_rad=np.deg2rad(120.0))
    procedure = procedure_of()
    own = procedure.fixture
    fixture = replace(own, fixture=replace(own.fixture, tolerance=vague))  # type: ignore[type-var]
    arm = WrongZero(procedure)
    arm.reset_counter(1)
    session = make_session(replace(procedure, fixture=fixture), arm=arm, connect=True)
    with pytest.raises(GuardError, match="joint 1 reads zero, outside the box") as found:
        take_poses(session, Listener(), (1, 5), homing=True)
    assert "go-home" not in str(found.value)
    assert arm.moves == []

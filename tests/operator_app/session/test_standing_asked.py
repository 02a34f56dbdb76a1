"""A session asks before it enables a drive whether what the joints read may be true, and keeps the answer."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.base import Tolerance
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled, GuardError
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from tests.oracles.opened import opened
from tests.oracles.wrong_zero import WrongZero


def procedure_of(name: str = "hinge") -> Procedure:
    procedure = load_procedure(name)
    return replace(procedure, capture=replace(procedure.capture, poses=2, samples_per_pose=8))


def refused(folder: Path, arm: WrongZero, procedure: Procedure, *, homing: bool) -> str:
    session = opened(folder, arm, procedure)
    session.connect()
    with pytest.raises(GuardError) as found:
        take_poses(session, Listener(), (1, 5), homing=homing)
    # The plant's own end holds it as well.
    arm.before_end = arm.enabled, arm.moved
    session.close("refused")
    return str(found.value)


@pytest.mark.parametrize("homing", [False, True])
def test_a_counter_that_began_anew_in_range_is_named_and_nothing_is_enabled(
    tmp_path: Path, homing: bool
) -> None:
    procedure = procedure_of()
    arm = WrongZero(procedure)
    arm.begin_anew(1)
    said = refused(tmp_path / "s", arm, procedure, homing=homing)
    assert "the counter of joint 1 is at zero" in said
    assert "Home joint 1" in said
    assert "go-home" not in said
    assert arm.before_end == (0, 0)


@pytest.mark.parametrize(("joint", "degrees"), [(1, -60.0), (2, 60.0), (3, 60.0), (4, -60.0)])
def test_a_zero_that_is_far_off_is_named_and_nothing_is_enabled(
    tmp_path: Path, joint: int, degrees: float
) -> None:
    procedure = procedure_of()
    arm = WrongZero(procedure)
    arm.off_rad[joint - 1] = np.deg2rad(degrees)
    said = refused(tmp_path / "s", arm, procedure, homing=True)
    assert "the loop cannot close with the present joint readings" in said
    assert f"it closes with joint {joint} near" in said
    assert "go-home" not in said
    assert arm.before_end == (0, 0)


def left_after(folder: Path, poses: int) -> tuple[WrongZero, Procedure]:
    """A session that was left after so many poses; the arm stands where it took the last."""
    procedure = procedure_of()
    procedure = replace(procedure, capture=replace(procedure.capture, poses=40))
    arm = WrongZero(procedure)
    session = opened(folder, arm, procedure)
    session.connect()
    session.cancelled = lambda: len(session.state.poses) == poses
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5))
    session.close("left")
    # It comes to rest before anybody looks again.
    arm.capture(500)
    return arm, procedure


def goes_on(folder: Path, arm: WrongZero, procedure: Procedure) -> str:
    """Why the session was refused; what was enabled and moved since is in `before_end`."""
    session = opened(folder, arm, procedure, resumed=True)
    session.connect()
    arm.enabled = arm.moved = 0
    with pytest.raises(GuardError) as found:
        take_poses(session, Listener(), (1, 5), homing=True)
    arm.before_end = arm.enabled, arm.moved
    session.close("refused")
    return str(found.value)


@pytest.mark.sample(3)
@pytest.mark.parametrize("poses", [1, 2])
@pytest.mark.parametrize("joint", [1, 2, 3, 4])
@pytest.mark.parametrize("degrees", [-60.0, 60.0])
def test_with_too_few_poses_to_tell_a_zero_that_is_far_off_is_named_all_the_same(
    tmp_path: Path, poses: int, joint: int, degrees: float
) -> None:
    arm, procedure = left_after(tmp_path / "s", poses)
    arm.off_rad[joint - 1] = np.deg2rad(degrees)
    assert "cannot close with the present joint readings" in goes_on(tmp_path / "s", arm, procedure)
    assert arm.before_end == (0, 0)


@pytest.mark.parametrize("poses", [1, 2])
def test_with_too_few_poses_to_tell_a_counter_at_zero_is_named_all_the_same(
    tmp_path: Path, poses: int
) -> None:
    arm, procedure = left_after(tmp_path / "s", poses)
    arm.begin_anew(1)
    assert "the counter of joint 1 is at zero" in goes_on(tmp_path / "s", arm, procedure)
    assert arm.before_end == (0, 0)


def test_a_sound_arm_with_too_few_poses_to_tell_goes_on(tmp_path: Path) -> None:
    arm, procedure = left_after(tmp_path / "s", 2)
    session = opened(tmp_path / "s", arm, procedure, resumed=True)
    session.connect()
    session.cancelled = lambda: len(session.state.poses) == 3
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5))
    assert len(session.state.poses) == 3
    session.close("left")


def _standings(folder: Path) -> list[dict[str, object]]:
    return [dict(e.data) for e in read_journal(folder).events if e.name == "standing"]


@pytest.mark.sample(1)
@pytest.mark.parametrize("poses", [0, 1, 20])
def test_why_it_was_refused_is_in_the_journal_and_that_it_passed(
    tmp_path: Path, poses: int
) -> None:
    folder = tmp_path / "s"
    procedure = procedure_of()
    procedure = replace(procedure, capture=replace(procedure.capture, poses=40))
    arm = WrongZero(procedure)
    if poses:
        arm, procedure = left_after(folder, poses)
        # The files alone let it pass before the first pose.
        (passed,) = _standings(folder)
        assert passed["refused"] is False
        assert 1e-12 < float(str(passed["probability"])) <= 1.0
        assert "within the tolerances of the files" in str(passed["told"])
    else:
        opened(folder, arm, procedure).close("left")
    before = len(_standings(folder))
    arm.off_rad[1] = np.deg2rad(60.0)
    said = goes_on(folder, arm, procedure)
    *_, last = found = _standings(folder)
    # With one pose: that it is too few to tell, then what the files say.
    assert len(found) == before + (2 if poses == 1 else 1)
    assert last["refused"] is True
    assert str(last["told"]) in said
    assert float(str(last["probability"])) < 1e-4
    # Whoever reads the journal takes it.
    assert session_state(read_journal(folder)).captured == poses


def test_a_counter_out_of_its_range_is_in_the_journal_as_well(tmp_path: Path) -> None:
    procedure = procedure_of()
    arm = WrongZero(procedure)
    arm.begin_anew(2)
    said = refused(tmp_path / "s", arm, procedure, homing=False)
    (last,) = _standings(tmp_path / "s")
    assert last["refused"] is True
    assert last["probability"] is None
    assert str(last["told"]) in said


def test_a_direction_that_is_wrong_is_named(tmp_path: Path) -> None:
    procedure = procedure_of()
    arm = WrongZero(procedure)
    arm.off_rad[1] = -2.0 * arm.snapshot().positions_rad[1]
    said = refused(tmp_path / "s", arm, procedure, homing=False)
    assert "it closes with joint 2 near" in said
    assert "direction" in said


def test_two_joints_exchanged_are_no_single_joint_s_fault(tmp_path: Path) -> None:
    procedure = procedure_of()
    arm = WrongZero(procedure)
    q = arm.snapshot().positions_rad
    arm.off_rad[[1, 2]] = q[[2, 1]] - q[[1, 2]]
    said = refused(tmp_path / "s", arm, procedure, homing=False)
    assert "ignoring any one joint's reading does not help" in said
    assert "order of the joints" in said


def test_where_the_files_say_too_little_no_agreement_drives_a_counter_at_zero(
    tmp_path: Path,
) -> None:
    """The loop tells nothing then; the box of the procedure still knows that zero is outside."""
    procedure = procedure_of()
    vague = Tolerance(position_m=1.0, orientation_rad=np.deg2rad(120.0))
    own = procedure.fixture
    fixture = replace(own, fixture=replace(own.fixture, tolerance=vague))  # type: ignore[type-var]
    procedure = replace(procedure, fixture=fixture)
    arm = WrongZero(procedure)
    arm.begin_anew(1)
    said = refused(tmp_path / "s", arm, procedure, homing=True)
    assert "joint 1 reads zero, outside the box of this procedure" in said
    assert "go-home" not in said
    assert arm.moved == 0

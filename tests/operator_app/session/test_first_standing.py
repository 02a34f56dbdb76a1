"""Before the drives of a new session are enabled: may what the joints read be true, where the arm stands?"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.base import Tolerance
from hardware.arm import ArmSnapshot, Reading
from hardware.virtual.drawn import Stated
from hardware.virtual.scenarios import scenario, scenario_of
from operator_app.calibration.standing import standing_loop
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled, GuardError
from operator_app.session.first_standing import check_first_standing
from operator_app.session.journal import read_journal
from operator_app.session.listener import Listener
from operator_app.session.replay import session_state
from operator_app.session.workflow import take_poses
from oracles.opened import opened
from oracles.plant_arm import PlantArm


class WrongZero(PlantArm):
    """The plant with a joint whose counter is off, or began anew where the arm stood at first."""

    def __init__(self, procedure: Procedure) -> None:
        super().__init__(procedure, scenario("datasheet", seed=3))
        self.off_rad = np.zeros(self.model.joint_count)
        self.enabled = self.moved = 0
        self.before_end = (0, 0)

    def begin_anew(self, joint: int) -> None:
        self.off_rad[joint - 1] = -self._positions()[joint - 1]

    def snapshot(self) -> ArmSnapshot:
        found = super().snapshot()
        q = found.positions_rad + self.off_rad
        joints = tuple(
            replace(j, position_rad=float(at), position_counts=round(at / self._resolution[k]))
            for k, (j, at) in enumerate(zip(found.joints, q, strict=True))
        )
        return replace(found, joints=joints)

    def capture(self, samples: int) -> Reading:
        found = super().capture(samples)
        mean = found.mean_rad + self.off_rad
        return replace(found, mean_rad=mean, mean_counts=mean / self._resolution)

    def take_control(self) -> None:
        self.enabled += 1
        super().take_control()

    def move(self, *args: object, **kwargs: object) -> object:  # type: ignore[override]
        self.moved += 1
        return super().move(*args, **kwargs)  # type: ignore[arg-type]


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
    assert "the counter of joint 1 stands at zero" in said
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
    assert "the loop cannot close where the arm stands" in said
    assert f"it would with joint {joint} near" in said
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


@pytest.mark.parametrize("poses", [1, 2])
@pytest.mark.parametrize("joint", [1, 2, 3, 4])
@pytest.mark.parametrize("degrees", [-60.0, 60.0])
def test_with_too_few_poses_to_tell_a_zero_that_is_far_off_is_named_all_the_same(
    tmp_path: Path, poses: int, joint: int, degrees: float
) -> None:
    arm, procedure = left_after(tmp_path / "s", poses)
    arm.off_rad[joint - 1] = np.deg2rad(degrees)
    assert "cannot close where the arm stands" in goes_on(tmp_path / "s", arm, procedure)
    assert arm.before_end == (0, 0)


@pytest.mark.parametrize("poses", [1, 2])
def test_with_too_few_poses_to_tell_a_counter_at_zero_is_named_all_the_same(
    tmp_path: Path, poses: int
) -> None:
    arm, procedure = left_after(tmp_path / "s", poses)
    arm.begin_anew(1)
    assert "the counter of joint 1 stands at zero" in goes_on(tmp_path / "s", arm, procedure)
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
        assert "within what its files leave open" in str(passed["told"])
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
    assert "it would with joint 2 near" in said
    assert "direction" in said


def test_two_joints_exchanged_are_no_single_joint_s_fault(tmp_path: Path) -> None:
    procedure = procedure_of()
    arm = WrongZero(procedure)
    q = arm.snapshot().positions_rad
    arm.off_rad[[1, 2]] = q[[2, 1]] - q[[1, 2]]
    said = refused(tmp_path / "s", arm, procedure, homing=False)
    assert "whichever joint's reading is left out" in said
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
    assert "joint 1 reads zero, where this procedure does not expect it" in said
    assert "go-home" not in said
    assert arm.moved == 0


FIXTURES = pytest.mark.parametrize("name", ["hinge", "ball", "rigid"])


@FIXTURES
@pytest.mark.parametrize("kind", ["exact", "datasheet", "as_reported", "wild"])
def test_a_sound_arm_is_not_refused_wherever_it_stands(name: str, kind: str) -> None:
    procedure = load_procedure(name)
    for seed in range(2):
        for q in sound_poses(procedure, kind, seed, 4):
            check_first_standing(procedure, _reading(procedure, q))


@FIXTURES
@pytest.mark.parametrize("kind", ["datasheet", "as_reported"])
@pytest.mark.parametrize("zeros", [(1,), (3,), (5,), (1, 4), (2, 3, 5)])
def test_a_sound_arm_whose_joints_truly_stand_at_zero_is_not_refused(
    name: str, kind: str, zeros: tuple[int, ...]
) -> None:
    """Where a counter begins is a convention: these stand at zero in this very pose."""
    procedure = load_procedure(name)
    for q in sound_poses(procedure, kind, 1, 3):
        anew, there = _zeroed(procedure, q, zeros, q)
        check_first_standing(anew, _reading(anew, there))


@FIXTURES
@pytest.mark.parametrize("zeros", [(1,), (3,), (2, 4), (3, 5), (1, 2, 3)])
def test_counters_that_began_anew_are_named_wherever_it_stands(
    name: str, zeros: tuple[int, ...]
) -> None:
    """By 40 deg each; a ball, which leaves four freedoms, says so of most of them only."""
    procedure = load_procedure(name)
    said = []
    for q in sound_poses(procedure, "datasheet", 1, 4):
        before = q.copy()
        before[[j - 1 for j in zeros]] -= np.deg2rad(40.0)
        anew, there = _zeroed(procedure, q, zeros, before)
        said.append(_said(anew, there))
    found = [text for text in said if text]
    assert len(found) == 4 or (name == "ball" and len(found) >= 2)
    for text in found:
        assert re.search(r"counters? of joints? [\d and]+ stands? at zero", text)
        assert any(re.search(rf"Home joint [\d and]*{j}", text) for j in zeros)


@pytest.mark.parametrize("degrees", [17.0, 22.0, 30.0])
def test_a_counter_that_began_anew_not_far_from_zero_is_named(degrees: float) -> None:
    """At 17 deg the loop closes with a chance of 1e-2, at 22 of 1e-4: little by itself, but not at zero."""
    procedure = load_procedure("hinge")
    q = procedure.arm.home_rad
    # The nearest closed pose has joint 1 elsewhere: a few times, and it has it there.
    for _ in range(20):
        there = q.copy()
        there[0] = np.deg2rad(degrees)
        (q,) = sound_poses(procedure, "datasheet", 1, 1, near=there)
    assert q[0] == pytest.approx(there[0], abs=np.deg2rad(0.1))
    read = q.copy()
    read[0] = 0.0
    with pytest.raises(GuardError, match="counter of joint 1 stands at zero") as refused:
        check_first_standing(procedure, _reading(procedure, read))
    assert "really stands at zero" in refused.value.remedy


def test_two_counters_that_began_anew_together_are_both_named() -> None:
    procedure = load_procedure("hinge")
    (q,) = sound_poses(procedure, "datasheet", 1, 1)
    before = q.copy()
    before[[1, 3]] -= np.deg2rad([40.0, -40.0])
    anew, there = _zeroed(procedure, q, (2, 4), before)
    with pytest.raises(GuardError, match="counters of joints 2 and 4 stand at zero") as refused:
        check_first_standing(anew, _reading(anew, there))
    assert "Home joint 2 and 4" in str(refused.value)


def test_joints_whose_home_is_near_zero_are_refused_by_more_than_a_doubt() -> None:
    """They stand there often; yet 30 deg are no doubt, though no 1e-12 either."""
    procedure = load_procedure("rigid")
    (q,) = sound_poses(procedure, "datasheet", 1, 1, near=procedure.arm.home_rad)
    for degrees, said in ((0.0, ""), (8.0, ""), (30.0, "counter of joint 2 stands at zero")):
        before = q.copy()
        before[1] -= np.deg2rad(degrees)
        anew, there = _zeroed(procedure, q, (2,), before)
        home = anew.arm.home_rad.copy()
        home[1] = 0.0
        anew = replace(anew, arm=replace(anew.arm, home_rad=home))
        found = _said(anew, there)
        assert said in found
        assert bool(said) == bool(found)


def _said(procedure: Procedure, q_rad: np.ndarray) -> str:
    """Why these readings are refused; empty if they are not."""
    try:
        check_first_standing(procedure, _reading(procedure, q_rad))
    except GuardError as refused:
        return str(refused)
    return ""


def sound_poses(
    procedure: Procedure, kind: str, seed: int, count: int, *, near: np.ndarray | None = None
) -> list[np.ndarray]:
    """Readings (n,) of closed poses of a drawn arm; up to 20 deg from home, or the nearest to `near`."""
    arm, fixture = procedure.arm, procedure.fixture.fixture
    stated = Stated(
        arm=arm,
        fixture=fixture,
        tolerance_m=fixture.tolerance.position_m,
        tolerance_rad=fixture.tolerance.orientation_rad,
    )
    truth = scenario_of(kind, seed, stated).true_loop()
    rng = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < count:
        away = np.deg2rad(rng.uniform(-20.0, 20.0, arm.joint_count))
        try:
            pose, _ = truth.closed_near(arm.home_rad + away if near is None else near)
        except ValueError:
            if near is not None:
                raise
            continue
        found.append(pose - truth.offsets_rad)
    return found


def _zeroed(
    procedure: Procedure, q_rad: np.ndarray, zeros: tuple[int, ...], truly_rad: np.ndarray
) -> tuple[Procedure, np.ndarray]:
    """The same arm where `zeros` count from `truly_rad` (n,), and what it reads at `q_rad` with all those at zero.

    With both the same they truly are there; else their counters began anew.
    """
    arm = procedure.arm
    moved = np.zeros(arm.joint_count)
    columns = [j - 1 for j in zeros]
    moved[columns] = truly_rad[columns]
    joints = tuple(
        replace(j, lower_rad=j.lower_rad - float(by), upper_rad=j.upper_rad - float(by))
        for j, by in zip(arm.joints, moved, strict=True)
    )
    table = replace(arm.table, theta_off_rad=arm.table.theta_off_rad + moved)
    read = q_rad - moved
    read[columns] = 0.0
    other = replace(arm, joints=joints, table=table, home_rad=arm.home_rad - moved)
    return replace(procedure, arm=other), read


def _reading(procedure: Procedure, q_rad: np.ndarray) -> Reading:
    resolution = np.array([j.sensor.resolution_rad for j in procedure.arm.joints])
    return Reading(
        mean_counts=q_rad / resolution,
        mean_rad=q_rad,
        sd_rad=np.zeros(len(q_rad)),
        samples=8,
        first_sync=1,
    )


def test_at_its_own_nominal_values_a_loop_costs_nothing() -> None:
    procedure = load_procedure("hinge")
    fixture = procedure.fixture.fixture
    q = standing_loop(procedure.arm, fixture, procedure.arm.home_rad).fit().q_rad
    found = standing_loop(procedure.arm, fixture, procedure.arm.home_rad).fit()
    assert 0.0 <= found.chi2 < 1.0
    assert found.dof == 5
    np.testing.assert_allclose(q, procedure.arm.home_rad, atol=np.deg2rad(3.0))

"""Before the drives of a new session are enabled: may what the joints read be true, where the arm stands?"""

from __future__ import annotations

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
from operator_app.session.listener import Listener
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
def test_with_too_few_poses_to_tell_a_counter_at_zero_is_named_all_the_same(
    tmp_path: Path, poses: int
) -> None:
    arm, procedure = left_after(tmp_path / "s", poses)
    arm.begin_anew(1)
    assert "the counter of joint 1 stands at zero" in goes_on(tmp_path / "s", arm, procedure)
    assert arm.before_end == (0, 0)


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


def test_a_sound_arm_with_too_few_poses_to_tell_goes_on(tmp_path: Path) -> None:
    arm, procedure = left_after(tmp_path / "s", 2)
    session = opened(tmp_path / "s", arm, procedure, resumed=True)
    session.connect()
    session.cancelled = lambda: len(session.state.poses) == 3
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5))
    assert len(session.state.poses) == 3
    session.close("left")


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


@pytest.mark.parametrize("name", ["hinge", "ball", "rigid"])
@pytest.mark.parametrize("kind", ["exact", "datasheet", "as_reported", "wild"])
def test_a_sound_arm_is_not_refused(name: str, kind: str) -> None:
    procedure = load_procedure(name)
    fixture = procedure.fixture.fixture
    stated = Stated(
        arm=procedure.arm,
        fixture=fixture,
        tolerance_m=fixture.tolerance.position_m,
        tolerance_rad=fixture.tolerance.orientation_rad,
    )
    for seed in range(2):
        plant = scenario_of(kind, seed, stated).build(procedure.arm)
        offsets = plant.truth.offsets_rad
        check_first_standing(procedure, _reading(plant.true_angles_rad[1:] - offsets))


def _reading(q_rad: np.ndarray) -> Reading:
    return Reading(
        mean_counts=np.full(len(q_rad), 1000.0),
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

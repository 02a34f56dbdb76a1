"""An arm that stands outside its box is moved by nothing but an agreement: nor by the way back to its first pose."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.arm import JointMode, MoveResult
from hardware.virtual.scenarios import scenario
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled, GuardError
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import HOMING_SPEED_RAD_PER_S
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.opened import opened
from tests.oracles.plant_arm import PlantArm

POSES = 6
OUTSIDE_RAD = float(np.deg2rad(102.5))
"""Of joint 1, whose box ends at 88.5 deg."""


class Watched(PlantArm):
    """The plant; keeps how fast it was told to go."""

    def __init__(self, procedure: Procedure) -> None:
        super().__init__(procedure, scenario("datasheet", seed=3))
        self.speeds_rad_per_s: list[float] = []

    def move(self, *args: object, **kwargs: object) -> MoveResult:  # type: ignore[override]
        self.speeds_rad_per_s.append(float(kwargs["speed_rad_per_s"]))  # type: ignore[arg-type]
        return super().move(*args, **kwargs)  # type: ignore[arg-type]

    def stand_at(self, joint_1_rad: float) -> None:
        """Be there truly, as after somebody else moved it; nothing of it counts."""
        self.take_control()
        self.set_modes([JointMode.POSITION if j in (1, 5) else JointMode.FREE for j in range(1, 8)])
        super().move({1: joint_1_rad}, speed_rad_per_s=0.5)
        self.settle(window=20, spread_rad=[1e-3] * 7, timeout_syncs=500)
        self.take_control()


def procedure_of(poses: int) -> Procedure:
    procedure = load_procedure("hinge")
    return replace(procedure, capture=replace(procedure.capture, poses=poses, samples_per_pose=8))


class Leaving(Listener):
    """Ends a session after so many poses."""

    def __init__(self, session: Session, poses: int) -> None:
        self._session, self._poses = session, poses

    def pose_captured(self, state: SessionState, wanted: int) -> None:
        if len(state.poses) == self._poses:
            self._session.cancelled = lambda: True


def resumed(folder: Path, *, wanted: int) -> tuple[Session, Watched]:
    """A session of 6 poses that goes on; meanwhile joint 1 was moved out of its box."""
    procedure = procedure_of(wanted)
    session = opened(folder, Watched(procedure), procedure)
    session.connect()
    with pytest.raises(Cancelled):
        take_poses(session, Leaving(session, POSES), (1, 5))
    session.close("left")
    arm = Watched(procedure)
    arm.stand_at(OUTSIDE_RAD)
    assert arm.snapshot().positions_rad[0] == pytest.approx(OUTSIDE_RAD, abs=np.deg2rad(0.1))
    going_on = opened(folder, arm, procedure, resumed=True)
    going_on.connect()
    return going_on, arm


# With poses still to come, and with nothing left to do but to read the first one again.
@pytest.mark.sample(1)
@pytest.mark.parametrize("wanted", [40, POSES])
def test_a_resume_does_not_drive_it_back_to_its_first_pose(tmp_path: Path, wanted: int) -> None:
    session, arm = resumed(tmp_path / "s", wanted=wanted)
    with pytest.raises(GuardError, match=r"joint 1 is at \+102\.\d+ deg, outside") as refused:
        take_poses(session, Listener(), (1, 5))
    assert "--go-home" in refused.value.remedy
    assert arm.speeds_rad_per_s == []
    assert len(session.state.used_poses) == POSES
    session.close("refused")


def test_with_an_agreement_it_goes_home_slowly_first(tmp_path: Path) -> None:
    session, arm = resumed(tmp_path / "s", wanted=40)
    session.cancelled = lambda: len(session.state.repeats) == 1
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5), homing=True)
    assert arm.speeds_rad_per_s[0] == HOMING_SPEED_RAD_PER_S
    assert len(session.state.repeats) == 1
    session.close("left")


@pytest.fixture(scope="module")
def exploring(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Procedure]:
    """A planned session that was left while it explored round its home."""
    procedure = load_procedure("hinge_planned")
    capture = replace(procedure.capture, samples_per_pose=8)
    procedure = replace(procedure, position_joints=(1, 5), capture=capture)
    folder = tmp_path_factory.mktemp("exploring") / "s"
    session = opened(folder, Watched(procedure), procedure)
    session.connect()
    with pytest.raises(Cancelled):
        take_poses(session, Leaving(session, 3), (1, 5))
    session.close("left")
    return folder, procedure


def moved_since(exploring: tuple[Path, Procedure], folder: Path) -> tuple[Session, Watched]:
    procedure = exploring[1]
    folder.mkdir()
    (folder / "journal.jsonl").write_bytes((exploring[0] / "journal.jsonl").read_bytes())
    arm = Watched(procedure)
    arm.stand_at(OUTSIDE_RAD)
    going_on = opened(folder, arm, procedure, resumed=True)
    going_on.connect()
    return going_on, arm


@pytest.mark.sample(1)
@pytest.mark.parametrize("withdrawn", [False, True], ids=["same campaign", "a new one"])
def test_a_planned_session_does_not_drive_it_back_either(
    exploring: tuple[Path, Procedure], tmp_path: Path, withdrawn: bool
) -> None:
    session, arm = moved_since(exploring, tmp_path / "s")
    if withdrawn:
        session.undo()
    with pytest.raises(GuardError, match=r"joint 1 is at \+102\.\d+ deg, outside") as refused:
        take_poses(session, Listener(), (1, 5))
    assert "--go-home" in refused.value.remedy
    assert arm.speeds_rad_per_s == []
    session.close("refused")


@pytest.mark.sample(1)
@pytest.mark.parametrize("withdrawn", [False, True], ids=["same campaign", "a new one"])
def test_with_an_agreement_a_planned_session_goes_home_slowly_first(
    exploring: tuple[Path, Procedure], tmp_path: Path, withdrawn: bool
) -> None:
    session, arm = moved_since(exploring, tmp_path / "s")
    if withdrawn:
        session.undo()
    kept = len(session.state.poses)
    session.cancelled = lambda: len(session.state.poses) == kept + 1
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5), homing=True)
    assert arm.speeds_rad_per_s[0] == HOMING_SPEED_RAD_PER_S
    assert len(arm.speeds_rad_per_s) > 1
    session.close("left")

"""An arm outside its box is moved only after the operator agrees, not even back to the first pose of a session."""

import shutil
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hardware.arm import JointMode
from hardware.virtual.scenarios import scenario
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled, GuardError
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import HOMING_SPEED_RAD_PER_S
from operator_app.session.workflow.listener import Listener
from tests.oracles.hearing import take_poses_until
from tests.oracles.opened import opened
from tests.oracles.plant_arm import PlantArm

POSES = 6
DATASHEET = scenario("datasheet", seed=3)
OUTSIDE_RAD = float(np.deg2rad(102.5))
"""Of joint 1, whose box ends at 88.5 deg."""


def arm_outside_box(procedure: Procedure) -> PlantArm:
    """The plant with joint 1 moved out of its box before the session."""
    arm = PlantArm(procedure, DATASHEET)
    arm.take_control()
    arm.set_modes([JointMode.POSITION if j in (1, 5) else JointMode.FREE for j in range(1, 8)])
    arm.move({1: OUTSIDE_RAD}, speed_rad_per_s=0.5)
    arm.settle(window=20, spread_rad=[1e-3] * 7, timeout_syncs=500)
    arm.take_control()
    arm.moves.clear()
    assert arm.snapshot().positions_rad[0] == pytest.approx(OUTSIDE_RAD, abs=np.deg2rad(0.1))
    return arm


def case_procedure(case: str) -> Procedure:
    """The procedure of a case; `planned` explores round home, `complete` has all its poses after a session."""
    procedure = load_procedure("hinge_planned" if case == "planned" else "hinge")
    capture = replace(procedure.capture, samples_per_pose=8)
    if case != "planned":
        capture = replace(capture, poses=POSES if case == "complete" else 40)
    return replace(procedure, position_joints=(1, 5), capture=capture)


@pytest.fixture(scope="module")
def session_folder(tmp_path_factory):
    """Folders of closed sessions by case."""

    @cache
    def make(case: str) -> Path:
        folder, procedure = tmp_path_factory.mktemp(case) / "s", case_procedure(case)
        session = opened(folder, PlantArm(procedure, DATASHEET), procedure)
        session.connect()
        take_poses_until(session, 3 if case == "planned" else POSES)
        session.close("left")
        return folder

    return make


CASES = pytest.mark.parametrize(
    ("case", "undone"),
    [("incomplete", False), ("complete", False), ("planned", False), ("planned", True)],
    ids=["incomplete", "complete", "planned", "new plan"],
)


@pytest.fixture
def resumed(session_folder, make_session, tmp_path, case, undone):
    """A resumed session whose arm is outside its box."""
    procedure = case_procedure(case)
    shutil.copytree(session_folder(case), tmp_path / "session")
    session = make_session(procedure, arm=arm_outside_box(procedure), resume=True, connect=True)
    if undone:
        session.undo()
    return session


@pytest.mark.sample(2)
@CASES
def test_resume_without_agreement_moves_nothing(resumed):
    before = len(resumed.state.poses)
    with pytest.raises(GuardError, match=r"joint 1 is at \+102\.\d+ deg, outside") as error:
        take_poses(resumed, Listener(), (1, 5))
    assert "--go-home" in error.value.remedy
    assert resumed.arm.moves == []
    assert len(resumed.state.poses) == before


@pytest.mark.sample(2)
@CASES
def test_resume_with_agreement_moves_home_slowly_first(resumed):
    def measured() -> tuple[int, int]:
        return len(resumed.state.repeats), len(resumed.state.poses)

    before = measured()
    resumed.cancelled = lambda: measured() != before
    with suppress(Cancelled):
        take_poses(resumed, Listener(), (1, 5), homing=True)
    assert measured() != before
    speeds = [speed for _, speed in resumed.arm.moves]
    assert speeds[0] == HOMING_SPEED_RAD_PER_S
    assert len(speeds) > 1

"""An arm that stands outside its box is moved by nothing but an agreement: nor by the way back to its first pose."""

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
from tests.oracles.hearing import take_until
from tests.oracles.opened import opened
from tests.oracles.plant_arm import PlantArm

POSES = 6
DATASHEET = scenario("datasheet", seed=3)
OUTSIDE_RAD = float(np.deg2rad(102.5))
"""Of joint 1, whose box ends at 88.5 deg."""


def standing_outside(procedure: Procedure) -> PlantArm:
    """The plant, its joint 1 truly out of its box, as after somebody else moved it; nothing of it counts."""
    arm = PlantArm(procedure, DATASHEET)
    arm.take_control()
    arm.set_modes([JointMode.POSITION if j in (1, 5) else JointMode.FREE for j in range(1, 8)])
    arm.move({1: OUTSIDE_RAD}, speed_rad_per_s=0.5)
    arm.settle(window=20, spread_rad=[1e-3] * 7, timeout_syncs=500)
    arm.take_control()
    arm.moves.clear()
    assert arm.snapshot().positions_rad[0] == pytest.approx(OUTSIDE_RAD, abs=np.deg2rad(0.1))
    return arm


def procedure_of(case: str) -> Procedure:
    """Of `planned`, which explores round its home, and of `whole` all poses are taken that were wanted."""
    procedure = load_procedure("hinge_planned" if case == "planned" else "hinge")
    capture = replace(procedure.capture, samples_per_pose=8)
    if case != "planned":
        capture = replace(capture, poses=POSES if case == "whole" else 40)
    return replace(procedure, position_joints=(1, 5), capture=capture)


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """Folders of sessions that were left, each made once."""

    @cache
    def make(case: str) -> Path:
        folder, procedure = tmp_path_factory.mktemp(case) / "s", procedure_of(case)
        session = opened(folder, PlantArm(procedure, DATASHEET), procedure)
        session.connect()
        take_until(session, 3 if case == "planned" else POSES)
        session.close("left")
        return folder

    return make


CASES = pytest.mark.parametrize(
    ("case", "withdrawn"),
    [
        ("more poses to come", False),
        ("whole", False),
        ("planned", False),
        # A new campaign.
        ("planned", True),
    ],
)


@pytest.fixture
def resumed(left, make_session, tmp_path, case, withdrawn):
    """A session that goes on; meanwhile joint 1 was moved out of its box."""
    procedure = procedure_of(case)
    shutil.copytree(left(case), tmp_path / "session")
    session = make_session(procedure, arm=standing_outside(procedure), resume=True, connect=True)
    if withdrawn:
        session.undo()
    return session


@pytest.mark.sample(2)
@CASES
def test_a_resume_does_not_drive_it_back_to_its_first_pose(resumed):
    before = len(resumed.state.poses)
    with pytest.raises(GuardError, match=r"joint 1 is at \+102\.\d+ deg, outside") as refused:
        take_poses(resumed, Listener(), (1, 5))
    assert "--go-home" in refused.value.remedy
    assert resumed.arm.moves == []
    assert len(resumed.state.poses) == before


@pytest.mark.sample(2)
@CASES
def test_with_an_agreement_it_goes_home_slowly_first(resumed):
    state = resumed.state
    before = (len(state.repeats), len(state.poses))
    resumed.cancelled = lambda: (len(resumed.state.repeats), len(resumed.state.poses)) != before
    with suppress(Cancelled):
        take_poses(resumed, Listener(), (1, 5), homing=True)
    assert (len(resumed.state.repeats), len(resumed.state.poses)) != before
    speeds = [speed for _, speed in resumed.arm.moves]
    assert speeds[0] == HOMING_SPEED_RAD_PER_S
    assert len(speeds) > 1

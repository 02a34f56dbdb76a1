"""What the session refuses, done to the controller all the same: the physics answers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hardware.arm import JointMode
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import DriveFault
from operator_app.composition import open_arm
from operator_app.session.workflow.opening import Choices, begin

EXCESS_TORQUE = 0x8311


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[CanopenArm]:
    """The virtual arm behind its bus, connected and under control."""
    opening = begin("hinge", Choices(scenario="exact"), root=tmp_path)
    with open_arm(opening) as rig:
        rig.arm.connect()
        rig.arm.take_control()
        yield rig.arm


def modes(*position_joints: int) -> list[JointMode]:
    return [JointMode.POSITION if j in position_joints else JointMode.FREE for j in range(1, 8)]


def wander_deg(arm: CanopenArm, syncs: int) -> float:
    """How far the joint that moves most goes by itself."""
    before = arm.snapshot().positions_rad
    arm.capture(syncs)
    return float(np.rad2deg(np.abs(arm.snapshot().positions_rad - before).max()))


def test_with_two_drive_joints_the_arm_stands(arm: CanopenArm) -> None:
    arm.set_modes(modes(1, 5))
    assert wander_deg(arm, 100) < 0.01


def test_with_one_drive_joint_the_arm_sags(arm: CanopenArm) -> None:
    arm.set_modes(modes(1))
    assert wander_deg(arm, 100) > 3.0


def test_with_three_drive_joints_torque_builds_up_until_8311h(arm: CanopenArm) -> None:
    arm.set_modes(modes(1, 3, 5))
    start = arm.snapshot().positions_rad
    with pytest.raises(DriveFault) as tripped:
        arm.move({1: float(start[0] + np.deg2rad(15.0))}, speed_rad_per_s=float(np.deg2rad(10.0)))
    assert tripped.value.code == EXCESS_TORQUE
    moved = np.rad2deg(np.abs(arm.snapshot().positions_rad - start).max())
    assert moved < 15.0

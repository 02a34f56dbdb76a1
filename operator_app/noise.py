"""What is random about a pose set: sensors by their specification, and which variances to estimate.

Knows arms, fixtures and pose sets; estimates nothing.
"""

from __future__ import annotations

import numpy as np

from fixtures.base import Fixture
from operator_app.loop_of_poses import instrument_variance
from solver.arm_model import ArmModel
from solver.arrays import BoolArray
from solver.component_model import ComponentPlan
from solver.implicit_estimator import NoiseModel
from solver.poses import PoseSet
from solver.sensors import NoSensor, Rvdt

DOF_FOR_COMPONENTS = 10
"""With fewer degrees of freedom no variance can be estimated beside the parameters: the sensors'
specifications are believed."""


def noise_model(arm: ArmModel, fixture: Fixture, poses: PoseSet, kept: BoolArray) -> NoiseModel:
    """Return what the sensors' specifications say of the mean readings of the kept poses."""
    samples = np.ones(len(poses), dtype=np.int64) if poses.samples is None else poses.samples
    variance = np.array(
        [
            [
                0.0 if isinstance(j.sensor, NoSensor) else j.sensor.variance_of_mean_rad2(int(n))
                for j in arm.joints
            ]
            for n in samples[kept]
        ]
    )
    return NoiseModel(joint_variance=variance, fixture_variance=instrument_variance(fixture))


def component_plan(
    arm: ArmModel, unsensed_joints: tuple[int, ...], fixture: Fixture, *, dof: int
) -> ComponentPlan:
    """Return which variances to estimate: each used RVDT's, and the flexure of what holds the hand."""
    if dof < DOF_FOR_COMPONENTS:
        return ComponentPlan(flexure=False)
    noisy = tuple(
        j
        for j, joint in enumerate(arm.joints, 1)
        if isinstance(joint.sensor, Rvdt) and j not in unsensed_joints
    )
    return ComponentPlan(noisy_joints=noisy, flexure=fixture.kind != "measured")

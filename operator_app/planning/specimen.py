"""Poses of a virtual arm in its fixture, taken on its plant without a bus. Knows no session and no calibration.

The same waypoints and the same samples as a session of the procedure takes them, without its watching.
"""

from __future__ import annotations

import numpy as np

from hardware.arm import JointMode
from hardware.canopen.objects import CONTROL_PERIOD_S
from hardware.virtual.port import JointCommand
from hardware.virtual.scenarios import Scenario
from operator_app.config.procedure import Procedure
from operator_app.planning.exploration import box_of, waypoints
from solver.arrays import FloatArray
from solver.chain.poses import PoseSet
from solver.chain.sensors import NoSensor

AT_REST = 40
"""Control periods after a move: the quasi-static chain has come to rest long before."""


def specimen_poses(procedure: Procedure, chosen: Scenario, *, poses: int) -> PoseSet:
    """Take `poses` poses of `chosen` as an explored session of `procedure` would."""
    arm, plan = procedure.arm, procedure.capture
    plant = chosen.build(arm)
    resolution = np.array(
        [
            0.0 if isinstance(joint.sensor, NoSensor) else joint.sensor.resolution_rad
            for joint in chosen.arm(arm).joints
        ]
    )
    drives = procedure.position_joints or ()
    modes = [
        JointMode.POSITION if j in drives else JointMode.FREE for j in range(1, arm.joint_count + 1)
    ]

    def step(targets_rad: FloatArray) -> FloatArray:
        commands = [
            JointCommand(mode=mode, target_rad=float(target))
            for mode, target in zip(modes, targets_rad, strict=True)
        ]
        return np.asarray(plant.step(commands).position_counts * resolution)

    held = [JointCommand(mode=None, target_rad=0.0)] * arm.joint_count
    here = np.asarray(plant.step(held).position_counts * resolution)
    box = box_of(arm, plan, drives, home_rad=arm.home_rad, start_rad=here)
    targets, taken, spreads = here.copy(), [], []
    for waypoint in waypoints(box, poses=plan.poses, seed=plan.seed)[:poses]:
        goal = targets.copy()
        for joint, angle in waypoint.items():
            goal[joint - 1] = angle
        farthest = float(np.abs(goal - targets).max())
        steps = max(1, round(farthest / (plan.speed_rad_per_s * CONTROL_PERIOD_S)))
        for share in np.linspace(0.0, 1.0, steps + 1)[1:].tolist():
            step(targets + share * (goal - targets))
        targets = goal
        for _ in range(AT_REST):
            step(targets)
        samples = np.array([step(targets) for _ in range(plan.samples_per_pose)])
        taken.append(samples.mean(axis=0))
        spreads.append(samples.std(axis=0, ddof=1))
    return PoseSet(
        placement=np.ones(poses, dtype=np.int64),
        label=tuple(str(k) for k in range(1, poses + 1)),
        q_rad=np.array(taken),
        sd_rad=np.array(spreads),
        samples=np.full(poses, plan.samples_per_pose, dtype=np.int64),
    )

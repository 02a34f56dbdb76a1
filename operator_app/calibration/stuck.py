"""A joint that does not move, or a sensor that does not say so? The loop can tell. Knows no screen."""

from __future__ import annotations

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.loop import loop_of_poses
from operator_app.calibration.noise import noise_model
from operator_app.units.figure import WHOLE_DEGREES
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.errors import SolverError, UnidentifiableError
from solver.estimators.implicit import fit_implicit

MOVED_RAD = np.deg2rad(3.0)
"""A joint that the loop says has turned by this has not stood still."""

CLOSES_RAD = np.deg2rad(0.5)
"""The loop says so only if it closes without the joint's reading, with other corrections this small."""

LEAST_NOISE_RAD = 1e-4


def explained(
    error: UnidentifiableError, arm: ArmModel, fixture: Fixture, poses: PoseSet
) -> UnidentifiableError:
    """Return the error with a stuck sensor named, where the loop shows that its joint moved."""
    still = sorted({j for d in error.directions for j in d.immobile_joints})
    for joint in still:
        moved = _moved(arm, fixture, poses, joint)
        if moved > MOVED_RAD:
            return UnidentifiableError(
                error.directions,
                code=f"FROZEN_JOINT_{joint}",
                note=f"yet the loop says that joint {joint} turned through {WHOLE_DEGREES(moved).with_unit}: "
                f"its sensor is stuck; check it, or calibrate with --unsensed {joint}",
            )
    return error


def _moved(arm: ArmModel, fixture: Fixture, poses: PoseSet, joint: int) -> float:
    """Angle (rad) through which the loop says a joint turned whose reading is not used; 0 if it can't."""
    unsensed = tuple(sorted({*arm.unsensed_joints, joint}))
    model = loop_of_poses(arm, fixture, poses, unsensed_joints=unsensed)
    noise = noise_model(arm, fixture, poses, np.ones(len(poses), dtype=np.bool_))
    variance: FloatArray = np.maximum(noise.joint_variance, LEAST_NOISE_RAD**2)
    try:
        with np.errstate(all="ignore"):
            fit = fit_implicit(
                model,
                poses.q_rad,
                type(noise)(joint_variance=variance, fixture_variance=noise.fixture_variance),
                nominal_vector(model.parameters),
            )
    except (SolverError, np.linalg.LinAlgError):
        return 0.0
    if not fit.converged or float(np.sqrt(np.mean(fit.corrections**2))) > CLOSES_RAD:
        return 0.0
    first = fit.unsensed.shape[-1] - len(unsensed)
    return float(np.ptp(fit.unsensed[:, first + unsensed.index(joint)]))

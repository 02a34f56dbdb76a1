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
from solver.closing import close_loops
from solver.design.motion import chain_motion
from solver.errors import SolverError, UnidentifiableError
from solver.estimators.implicit import fit_implicit
from solver.loops.closure import ClosureModel

MOVED_RAD = np.deg2rad(3.0)
"""A joint that the loop says has turned by this has not stood still."""

CLOSES_RAD = np.deg2rad(0.5)
"""The loop says so only if it closes without the joint's reading, with other corrections this small."""

LEAST_NOISE_RAD = 1e-4

TELLING = 4.0
TOLD = 0.1
"""Joints have turned unread where the others' motions fit so many times better to that than to their standing
still, and where standing leaves this share of them untold: between poses far apart the chain's motions are
bent, the placement is known roughly, and four drives hardly overdetermine a turn.
"""


def turns_unread(
    model: ClosureModel, x: FloatArray, q_rad: FloatArray, moved_rad: FloatArray, still: list[int]
) -> FloatArray:
    """Turns (rad) of joints that read no change, as the others' go with them by the chain's motions at a pose.

    0 where the others' motions, long ones too, are told nearly as well by a joint that stood.

    Parameters
    ----------
    q_rad, moved_rad
        Readings of a pose (n,), and by how much they changed from it or to it.
    still
        The joints, 1-based.
    """
    closed = close_loops(model, x, q_rad[None])
    tangent = chain_motion(model, x, closed.q, closed.u).tangent[0]
    columns = [j - 1 for j in still]
    others = np.setdiff1d(np.arange(len(moved_rad)), columns)
    along, wanted = tangent[others], moved_rad[others]
    free = np.linalg.lstsq(along, wanted, rcond=None)[0]
    left = float(np.linalg.norm(along @ free - wanted))
    # Motions in which all of them stand: the null space of their rows.
    stand = np.linalg.svd(tangent[columns])[2][len(columns) :].T
    held = stand @ np.linalg.lstsq(along @ stand, wanted, rcond=None)[0]
    standing = float(np.linalg.norm(along @ held - wanted))
    if standing < max(TELLING * left, TOLD * float(np.linalg.norm(wanted))):
        return np.zeros(len(still))
    return np.asarray(tangent[columns] @ free)


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

"""Stuck joints and sensors: joints that turned according to the loop although their reading did not change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fixtures.base import EndpointConstraint
from operator_app.calibration.closed_loops import loop_of_poses
from operator_app.calibration.error_model import noise_model
from operator_app.units import WHOLE_DEGREES
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.closing import close_loops
from solver.diagnostics.limits import (
    STUCK_JOINT_CORRECTION_RAD,
    STUCK_JOINT_CORRECTION_RATIO,
    STUCK_JOINT_MOTION_SHARE,
    STUCK_JOINT_TURN_RAD,
)
from solver.errors import SolverError, UnidentifiableError
from solver.estimators.implicit import fit_implicit
from solver.loops.closure import ClosureModel

LEAST_NOISE_RAD = 1e-4


LOOSE = 100.0
"""Standard deviation of a joint that may be anywhere, beside the others' 1."""


def turned_unread(
    model: ClosureModel,
    x: FloatArray,
    before_rad: FloatArray,
    after_rad: FloatArray,
    still: Sequence[int],
) -> tuple[int, float] | None:
    """Joint that turned between two readings although it reads alike, and by how much (rad); None if none did.

    Closes the loop at the second reading, corrected by what the first one lacked: with the joints standing,
    and with one of them turned as it must. What the placement is off by is in both readings, and the moves may
    be long: nothing is taken for straight.

    Parameters
    ----------
    x
        Parameters (P,), roughly known.
    before_rad, after_rad
        Readings (n,).
    still
        The joints that read alike, 1-based.
    """
    first = close_loops(model, x, before_rad[None])
    if not first.closed[0]:
        return None
    start = after_rad + first.q[0] - before_rad
    sigma = np.ones(len(start))
    sigma[[j - 1 for j in still]] = 0.0
    standing = _correction(model, x, start, sigma)
    asked = np.inf if standing is None else float(np.linalg.norm(standing))
    best: tuple[float, int, float] | None = None
    for joint in still:
        loose = sigma.copy()
        loose[joint - 1] = LOOSE
        found = _correction(model, x, start, loose)
        if found is not None:
            turn = float(found[joint - 1])
            found[joint - 1] = 0.0
            best = min(filter(None, (best, (float(np.linalg.norm(found)), joint, turn))))
    least = STUCK_JOINT_MOTION_SHARE * float(np.linalg.norm(after_rad - before_rad))
    if best is None or asked < max(STUCK_JOINT_CORRECTION_RATIO * best[0], least):
        return None
    return best[1:]


def _correction(
    model: ClosureModel, x: FloatArray, start_rad: FloatArray, sigma: FloatArray
) -> FloatArray | None:
    """Smallest correction (n,) in this measure that closes the loop; None if it does not close."""
    closed = close_loops(model, x, start_rad[None], sigma_rad=sigma)
    return closed.q[0] - start_rad if closed.closed[0] else None


def explained(
    error: UnidentifiableError, arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet
) -> UnidentifiableError:
    """Return the error with a stuck sensor named, where the loop shows that its joint moved."""
    still = sorted({j for d in error.directions for j in d.immobile_joints})
    for joint in still:
        moved = _moved(arm, fixture, poses, joint)
        if moved > STUCK_JOINT_TURN_RAD:
            return UnidentifiableError(
                error.directions,
                code=f"FROZEN_JOINT_{joint}",
                stuck_joint=joint,
                note=f"yet the loop says that joint {joint} turned through {WHOLE_DEGREES(moved).with_unit}: "
                f"its sensor is stuck; check it, or calibrate with --unsensed {joint}",
            )
    return error


def _moved(arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet, joint: int) -> float:
    """Range (rad) of a joint's angle as the loop determines it without its reading; 0 if the loop does not."""
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
    if (
        not fit.converged
        or float(np.sqrt(np.mean(fit.corrections**2))) > STUCK_JOINT_CORRECTION_RAD
    ):
        return 0.0
    first = fit.unsensed.shape[-1] - len(unsensed)
    return float(np.ptp(fit.unsensed[:, first + unsensed.index(joint)]))

"""Second opinions on a calibration from its own poses: jackknife, hold-out. Knows no screen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.noise import error_model, noise_model, soften, without_known_errors
from operator_app.calibration.solution import Solution
from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.errors import SolverError
from solver.estimators.estimate import Estimate
from solver.estimators.implicit import NoiseModel
from solver.estimators.variance_components import estimate_with_errors
from solver.judging.holdout import HoldOut, far_block, fold_poses, hold_out
from solver.judging.statistics import jackknife
from solver.loops.closure import ClosureModel

FOLDS = 5
FAR_SHARE = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Checks:
    """Second opinions on an implicit solution, each None or empty where it cannot be had.

    Attributes
    ----------
    jackknife_sd
        Standard deviation of every parameter (P,) by leaving out each pose in turn.
    held_out
        Parts of the poses judged by what the others give.
    far_block
        The same for one block of poses far from the rest: extrapolation.
    """

    jackknife_sd: FloatArray | None = None
    held_out: HoldOut | None = None
    far_block: HoldOut | None = None


def check(solution: Solution, arm: ArmModel, fixture: Fixture, poses: PoseSet) -> Checks:
    """Check a solution by the poses it was made from; of the paper's estimator there is nothing to say."""
    if solution.estimate.corrections is None:
        return Checks()
    if len(poses) - len(solution.dropped_flipped) < 2 * FOLDS:
        return Checks()
    kept = np.ones(len(poses), dtype=np.bool_)
    kept[list(solution.dropped_flipped)] = False
    q, model = poses.q_rad[kept], solution.model
    stated = noise_model(arm, fixture, poses, kept)
    found = stated
    x, straight, loop = solution.estimate.x, q, model
    if solution.components is not None:
        found = solution.components.noise
        loop, x, straight = without_known_errors(
            model, x, q, tolerated=solution.tolerated, components=solution.components
        )
    return Checks(
        jackknife_sd=None if solution.tolerated else _jackknife_sd(loop, straight, found, x),
        held_out=_held_out(solution, arm, fixture, poses, kept, fold_poses(q, FOLDS)),
        far_block=_held_out(solution, arm, fixture, poses, kept, (far_block(q, FAR_SHARE),)),
    )


def _jackknife_sd(
    model: ClosureModel, q: FloatArray, noise: NoiseModel, x: FloatArray
) -> FloatArray | None:
    try:
        return jackknife(model, q, noise, x).standard_deviation
    except SolverError:
        return None


def _held_out(
    solution: Solution,
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    kept: BoolArray,
    parts: tuple[IntArray, ...],
) -> HoldOut | None:
    model, there = solution.model, np.flatnonzero(kept)
    tolerance = {
        name: sd
        for name, sd in soften(model.without(solution.tolerated), arm)[1].items()
        if name in solution.tolerated
    }
    errors = error_model(
        arm,
        fixture,
        poses,
        kept,
        unsensed_joints=model.unsensed_joints,
        tolerance=tolerance,
    )

    def estimator(rest: IntArray) -> Estimate:
        return estimate_with_errors(
            model.at_poses(rest),
            poses.q_rad[there[rest]],
            errors.at_poses(rest),
            x0=solution.estimate.x,
            group=poses.placement[there[rest]],
        ).estimate

    try:
        return hold_out(
            estimator, model, poses.q_rad[kept], noise_model(arm, fixture, poses, kept), parts
        )
    except SolverError:
        # The rest is too small to be estimated from.
        return None

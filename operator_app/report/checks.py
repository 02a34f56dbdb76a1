"""What a report checks a calibration by: jackknife, outliers, hold-out, RVDT verdicts. Knows no HTML."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fixtures.errors import FixtureError
from operator_app.calibration import Solution, component_plan, noise_model
from operator_app.config.procedure import Procedure
from solver.arrays import BoolArray, FloatArray
from solver.closure import ClosureModel, DhLoop
from solver.errors import SolverError
from solver.estimate import Estimate
from solver.holdout import HoldOut, fold_poses, hold_out
from solver.implicit_estimator import NoiseModel
from solver.poses import PoseSet
from solver.rvdt import RvdtVerdict, rvdt_verdicts
from solver.sensors import Rvdt
from solver.statistics import Outlier, jackknife, outlier_poses
from solver.variance_components import estimate_implicit_with_components

FOLDS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Checks:
    """Second opinions on an implicit solution, each None or empty where it cannot be had.

    Attributes
    ----------
    jackknife_sd
        Standard deviation of every parameter (P,) by leaving out each pose in turn.
    outliers
        Poses that do not fit the others; indices into the poses used.
    held_out
        Parts of the poses judged by what the others give.
    rvdt
        One verdict an RVDT joint.
    """

    jackknife_sd: FloatArray | None = None
    outliers: tuple[Outlier, ...] = ()
    held_out: HoldOut | None = None
    rvdt: tuple[RvdtVerdict, ...] = ()


def check(solution: Solution, procedure: Procedure, poses: PoseSet) -> Checks:
    """Check an implicit solution by the poses it was made from."""
    kept = np.ones(len(poses), dtype=np.bool_)
    kept[list(solution.dropped_flipped)] = False
    q, model = poses.q_rad[kept], solution.model
    stated = noise_model(procedure.arm, procedure.fixture.fixture, poses, kept)
    found = stated if solution.components is None else solution.components.noise
    x = solution.estimate.x
    return Checks(
        jackknife_sd=_jackknife_sd(model, q, found, x),
        outliers=outlier_poses(model, q, found, x),
        held_out=_held_out(solution, procedure, q, stated),
        rvdt=_rvdt(procedure, poses, kept, stated),
    )


def _jackknife_sd(
    model: ClosureModel, q: FloatArray, noise: NoiseModel, x: FloatArray
) -> FloatArray | None:
    try:
        return jackknife(model, q, noise, x).standard_deviation
    except SolverError:
        return None


def _held_out(
    solution: Solution, procedure: Procedure, q: FloatArray, noise: NoiseModel
) -> HoldOut | None:
    plan = component_plan(procedure.arm, solution.model.unsensed_joints, procedure.fixture.fixture)

    def estimator(model: ClosureModel, rest: FloatArray, of_rest: NoiseModel) -> Estimate:
        return estimate_implicit_with_components(model, rest, of_rest, plan)[0]

    if len(q) < 2 * FOLDS:
        return None
    try:
        return hold_out(estimator, solution.model, q, noise, fold_poses(q, FOLDS))
    except SolverError:
        # The rest is too small to be estimated from.
        return None


def _rvdt(
    procedure: Procedure, poses: PoseSet, kept: BoolArray, noise: NoiseModel
) -> tuple[RvdtVerdict, ...]:
    arm = procedure.arm
    joints = [j for j, joint in enumerate(arm.joints, 1) if isinstance(joint.sensor, Rvdt)]
    unsensed = tuple(sorted({*joints, *arm.unsensed_joints}))
    try:
        model = procedure.fixture.fixture.model(arm, unsensed_joints=unsensed)
        # Other loops have no equations to spare for measuring joints.
        if not joints or not isinstance(model, DhLoop):
            return ()
        return rvdt_verdicts(model, arm, poses.q_rad[kept], noise)
    except (SolverError, FixtureError):
        return ()

"""Cross-validation of a calibration with its own poses: jackknife, held-out folds and a far block."""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fixtures.base import EndpointConstraint
from operator_app.calibration.error_model import averaged_at_rest, distinct_poses
from operator_app.calibration.experiment import Experiment, with_angles_of_unsensed
from operator_app.calibration.instrument_registration import with_calibrated_places
from operator_app.calibration.prediction import errors_as_calibrated
from operator_app.calibration.result import Solution
from solver.arrays import FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics.cross_validation import FOLDS, HoldOut, far_block, fold_poses, hold_out
from solver.diagnostics.statistics import jackknife
from solver.errors import SolverError
from solver.estimators.layout import Layout
from solver.estimators.mixed_fit import MixedFit
from solver.estimators.variance_components import estimate_of, settle


@dataclass(frozen=True, slots=True, kw_only=True)
class Checks:
    """Cross-validation of an implicit solution; a part that could not be computed is None.

    `jackknife_sd`: standard deviation (rad, m) of every identified parameter, from leaving out each pose in turn;
    parameters only corrected within tolerances are not included.
    `held_out`: parts of the poses, each tested with the estimate from all other poses.
    `far_block`: test of a block of poses far from all others, with the estimate from these others (extrapolation).
    """

    jackknife_sd: FloatArray | None = None
    held_out: HoldOut | None = None
    far_block: HoldOut | None = None


def check(solution: Solution, arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet) -> Checks:
    """Check a solution with its own poses; the result is empty for the paper's estimator or too few poses."""
    poses = with_angles_of_unsensed(arm, fixture, averaged_at_rest(arm, poses))
    kept = ~np.isin(np.arange(len(poses)), solution.dropped_flipped)
    used, _ = distinct_poses(poses, kept)
    if len(used) < 2 * FOLDS or (components := solution.components) is None:
        return Checks()
    fixture = with_calibrated_places(fixture, solution.model)
    model = solution.model.at_poses(np.searchsorted(np.flatnonzero(kept), used))
    experiment = Experiment(arm=arm, fixture=fixture, poses=poses, unsensed=model.unsensed_joints)
    stated = experiment.at_poses(used)
    q, errors = stated.poses.q_rad, errors_as_calibrated(solution, model, experiment, used)
    errors = replace(errors, signed=components.signed)

    def settled(rest: IntArray) -> tuple[MixedFit, IntArray]:
        return settle(
            model.at_poses(rest),
            q[rest],
            errors.at_poses(rest),
            x0=solution.estimate.x,
            group=stated.poses.placement[rest],
            # The variances stay fixed: estimating them for every part would take most of the time.
            variances=partial(Layout.variances_by_name, named=components.variances),
        )

    whole, order = settled(np.arange(len(q)))

    def held_out(parts: tuple[IntArray, ...]) -> HoldOut | None:
        # Without a result if the remaining poses are too few for an estimate.
        with suppress(SolverError):
            return hold_out(
                lambda rest: estimate_of(*settled(rest)), model, q, whole.fit, order, parts
            )
        return None

    identified = [k for k, p in enumerate(model.parameters) if p.name not in solution.tolerated]
    jackknife_sd = None
    with suppress(SolverError):
        jackknife_sd = jackknife(whole.fit)[identified]
    return Checks(
        jackknife_sd=jackknife_sd,
        held_out=held_out(fold_poses(q)),
        far_block=held_out((far_block(q),)),
    )

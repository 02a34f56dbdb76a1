"""A calibration with all that is said of it: how well the hand is known, the verdict, every notice in its order.

Knows solutions and judgements; decides nothing and knows no screen.
"""

from __future__ import annotations

from dataclasses import replace

from fixtures.base import Fixture
from operator_app.calibration.acceptance import Judgement
from operator_app.calibration.adjudication import PriorInformation
from operator_app.calibration.calibrated_arm import (
    calibrated_arm,
    hand_accuracy,
    hand_errors,
    offsets_not_sought,
    with_held,
)
from operator_app.calibration.distances import contradicted
from operator_app.calibration.excluded_poses import left_out_in_words, out_of_range_besides
from operator_app.calibration.notices import (
    ASTRAY,
    as_stated_notices,
    cause_notices,
    condition_notices,
    distance_notices,
    endpoint_notices,
    flexure_notices,
    held_notices,
    indistinguishable_notices,
    left_out_notices,
    noise_notices,
    not_sought_notices,
    outlier_notices,
    range_notices,
    reasons_against,
    rival_notices,
    rvdt_notices,
    setup_notices,
)
from operator_app.calibration.placements import IndistinguishablePlacements
from operator_app.calibration.result import Solution
from operator_app.config.procedure import AcceptanceLimits
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.estimators.variance_components import Calibrated


def with_notices(
    solution: Solution,
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    *,
    whole: Calibrated,
    judged: Calibrated,
    known: PriorInformation,
    same: tuple[IndistinguishablePlacements, ...],
    as_stated: tuple[str, ...],
    judgement: Judgement,
    limits: AcceptanceLimits,
) -> Solution:
    """Add how well the hand is known, the verdict, and every notice in its order.

    `whole` is the fit of all poses, `judged` that of those the tests saw; `as_stated` is known by the files
    rather than by the poses.
    """
    found_arm = calibrated_arm(solution, arm)
    errors_there = hand_errors(found_arm, arm)
    accuracy = with_held(
        hand_accuracy(errors_there), errors_there.after_m, found_arm, arm, judged.linear
    )
    # What was dropped on request has its own words.
    not_sought = tuple(
        j for j in offsets_not_sought(solution.model, arm) if f"theta_off_{j}" not in solution.held
    )
    astray = judgement.diverged
    left_out = (solution.dropped_flipped, known.out_of_range, arm, poses)
    return replace(
        solution,
        accuracy=accuracy,
        warnings=(
            *((ASTRAY,) if astray else ()),
            *noise_notices(whole.linear.stated.chi2, whole.linear.dof),
            *range_notices(out_of_range_besides(*left_out), poses.label),
            *endpoint_notices(fixture, poses),
            *(() if astray else setup_notices(known.checks)),
            *left_out_notices(left_out_in_words(*left_out)),
            *held_notices(solution.held, accuracy),
            *not_sought_notices(not_sought, accuracy, arm),
            *as_stated_notices(as_stated, solution.estimate, solution.shares),
            *rival_notices(solution.search),
            *(() if astray else flexure_notices(solution.components, solution.tolerated)),
            *indistinguishable_notices(same),
            *distance_notices(contradicted(solution.distances)),
            *(() if astray else outlier_notices(solution.outliers)),
            *rvdt_notices(solution.rvdt),
            *cause_notices(judgement.causes),
            *(() if astray else condition_notices(solution.seen, limits)),
        ),
        judgement=judgement,
        reasons=(*judgement.reasons, *reasons_against(solution.estimate, limits)),
    )

"""From a pose set to a judged calibration: both estimators, what they can see, warnings, verdict.

The one place that decides what a calibration is worth; `sarcal solve`, the session and the terminal
app all call it. Knows no file, no bus and no screen.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.adjudication import PriorInformation, adjudicate
from operator_app.calibration.alternatives import named_rivals
from operator_app.calibration.calibrated_arm import with_best_table
from operator_app.calibration.closed_loops import in_order, loop_of_poses, pick
from operator_app.calibration.error_model import (
    error_model,
    first_of_each,
    soften,
    stated_priors,
)
from operator_app.calibration.failure_analysis import (
    do_not_fit,
    saturated_readings,
    why_blind,
)
from operator_app.calibration.instrument_registration import as_seen
from operator_app.calibration.local_minima import best_about_nominal
from operator_app.calibration.multistart import FEW, evenly, fitted, gross_misfit
from operator_app.calibration.observations import seen_loops
from operator_app.calibration.placements import alike, distances
from operator_app.calibration.refusals import (
    placement_checks,
    refuse_placement,
    require_identifiable,
)
from operator_app.calibration.repeat_measurement import Reread, repeats_of
from operator_app.calibration.result import Solution
from operator_app.calibration.rvdt import judge_rvdts
from operator_app.calibration.tool_accuracy import tip_sigma
from operator_app.calibration.with_notices import with_notices
from operator_app.config.procedure import AcceptanceLimits
from solver.arrays import FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics.identifiability import (
    Identifiability,
    condition_at_readings,
    identifiability,
    identifiability_of_fit,
    well_conditioned_at_readings,
)
from solver.diagnostics.limits import (
    CHI2_PER_DOF_GROSS,
    LEAST_INFORMATION_SHARE,
    OUTLIER_NOTICE_PROBABILITY,
)
from solver.diagnostics.range_checks import range_findings
from solver.errors import PosesDoNotFitError, UnidentifiableError
from solver.estimators.estimate import require_enough_poses
from solver.estimators.goodness import closure_at_readings, closure_sigmas
from solver.estimators.least_squares import Progress
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import Calibrated, VarianceComponents
from solver.posterior.scales import learned_scales, shares_of_poses

ESTIMATORS = ("implicit", "paper")

JUDGED = 2000
"""Poses, evenly among all, that tests and the verdict on RVDTs look at: more tell them nothing."""


def calibrate(
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    *,
    estimator: str = "implicit",
    unsensed_joints: tuple[int, ...] = (),
    search: bool = False,
    drop: bool = False,
    length_tolerance_m: float | None = None,
    limits: AcceptanceLimits | None = None,
    rereads: tuple[Reread, ...] = (),
    progress: Progress | None = None,
) -> Solution:
    """Calibrate `arm` in `fixture` from measured poses.

    Parameters
    ----------
    search
        Start from everywhere (global start) instead of from the nominal values.
    length_tolerance_m
        How well the maker's link lengths are known (standard deviation), instead of what the arm's
        file states. The implicit estimator corrects them within that.
    drop
        Hold at their nominal values what the poses cannot see, instead of refusing.
    rereads
        Poses that were read once more after others: no more data, but a test of all of them.

    Raises
    ------
    ReadingsOutOfRangeError
        These are no readings of this arm, or angles in another unit.
    TooFewPosesError, UnidentifiableError, FixtureRefusedError, EndpointMissingError
        The data cannot give what is asked for; each says what is missing.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator must be one of {', '.join(ESTIMATORS)}")
    limits = AcceptanceLimits() if limits is None else limits
    fixture = as_seen(arm, fixture, poses)
    unsensed_joints = tuple(sorted({*unsensed_joints, *arm.unsensed_joints}))
    if estimator == "paper" and unsensed_joints:
        raise ValueError("the paper's estimator needs every joint sensed (eqs. 10-13)")
    model = loop_of_poses(arm, fixture, poses, unsensed_joints=unsensed_joints)
    require_enough_poses(model, len(poses))
    out_of_range = range_findings(arm, poses, unsensed_joints=unsensed_joints)
    refuse_placement(fixture, arm, model)

    loops = seen_loops(
        model, arm, poses, sensed=not unsensed_joints, search=search, drop=drop, progress=progress
    )
    hard, q, paper, found = loops.model, loops.q, loops.paper, loops.search
    alone = loops.alone
    if estimator == "paper":
        hard = alone
    kept, flipped, blind = loops.kept, loops.flipped, loops.blind
    sigma, held = arm.sigma_rad(), loops.blind if drop else ()

    def require(seen: Identifiability) -> Identifiability:
        try:
            require_identifiable(seen, hard, len(q), known=() if estimator == "paper" else by_arm)
        except UnidentifiableError as error:
            used = pick(poses, np.flatnonzero(kept))
            raise why_blind(
                error,
                arm,
                fixture,
                used,
                unsensed_joints,
                paper,
                saturated_readings(out_of_range, poses),
            ) from error
        return seen

    prior = stated_priors(hard, arm, fixture)
    by_arm = set(prior) - {*hard.ground_side, *hard.hand_side}
    # Before anything is weighted: along a direction that neither poses nor files tell no estimate is worth anything.
    if paper is not None and (estimator == "paper" or not well_conditioned_at_readings(paper, q)):
        seen = require(identifiability(alone, paper.x, q, sigma_rad=sigma))
    x0 = loops.x0 if paper is None else paper.x
    # The paper's estimate is judged by what weighing every reading by its noise gives beside it.
    model, tolerance = soften(hard, arm, length_tolerance_m=length_tolerance_m, held=held)
    there = np.flatnonzero(kept)
    distinct, which = first_of_each(poses, kept)
    found_there = np.searchsorted(there, distinct)
    errors = error_model(
        arm,
        fixture,
        poses,
        distinct,
        unsensed_joints=unsensed_joints,
        tolerance=tolerance,
        prior=prior,
    )

    def starts() -> Iterator[FloatArray | None]:
        if by_arm and not search and not unsensed_joints:
            # Within what the files state of the arm, from where the fixture then stands.
            fixture_only = hard.without(by_arm)
            yield in_order(model, fixture_only, estimate_paper(fixture_only, q).x)
        yield None if x0 is None else in_order(model, alone, x0)
        yield nominal_vector(model.parameters)
        if not unsensed_joints:
            few = evenly(len(q), FEW)
            yield in_order(model, alone, best_about_nominal(alone.at_poses(few), q[few]))

    try:
        whole = fitted(
            model.at_poses(found_there),
            q[found_there],
            errors,
            starts(),
            group=poses.placement[distinct],
            progress=progress,
        )
    except PosesDoNotFitError as error:
        rivals = named_rivals(
            arm,
            fixture,
            pick(poses, distinct),
            unsensed=unsensed_joints,
            scale=np.inf,
            dof=len(distinct) * hard.equations_per_pose - len(alone.parameters),
        )
        raise do_not_fit(rivals) from error
    components: VarianceComponents | None
    estimate, components = whole.estimate, whole.components
    if len(which) != len(distinct):
        estimate, components = estimate.at_poses(which), components.at_poses(which)
    judged, some = whole.few(JUDGED)
    closes = gross_misfit(whole) < CHI2_PER_DOF_GROSS
    same = alike(model, whole.estimate) if closes else ()
    unknowns, seeable = (tuple(p.name for p in m.parameters) for m in (hard, alone))
    outliers = _outliers(whole, distinct)
    judged_paper = paper if estimator == "paper" else None
    implicit = None
    if judged_paper is not None:
        implicit = estimate.without(tuple(tolerance))
        estimate, components, model, tolerance = judged_paper, None, hard, {}
    else:
        # Where there was a first estimate the fit ended at loops that close.
        seen = require(
            identifiability_of_fit(judged.linear, seeable, taken=judged.order)
            if paper is not None
            else identifiability(alone, in_order(alone, model, estimate.x), q, sigma_rad=sigma)
        )
    checks = placement_checks(fixture, arm, model, estimate.x)
    rvdt = (
        judge_rvdts(
            arm,
            fixture,
            poses,
            kept,
            distinct[some],
            judged,
            held=held,
            length_tolerance_m=length_tolerance_m,
        )
        if closes
        else ()
    )
    shares = {} if judged_paper is not None else shares_of_poses(whole.linear)
    by_files = tuple(n for n in unknowns if shares.get(n, 1.0) < LEAST_INFORMATION_SHARE)
    known = PriorInformation(
        out_of_range=out_of_range,
        flipped=flipped,
        checks=checks,
        search=found,
        rvdt=rvdt,
        returned=repeats_of(
            rereads, arm, model, estimate.x, tuple(poses.label[k] for k in there), fixture.give
        ),
        by_files=by_files,
    )
    judgement = adjudicate(
        judged,
        arm,
        fixture,
        poses,
        distinct[some],
        judged=unknowns,
        known=known,
        paper=judged_paper,
    )
    nominal = nominal_vector(model.parameters)
    at_nominal = closure_at_readings(model, nominal, q)
    solution = Solution(
        model=model,
        estimate=estimate,
        paper=paper,
        seen=seen,
        before=closure_sigmas(at_nominal.residual, at_nominal.rotation_rows),
        poses=len(q),
        dropped_flipped=flipped,
        held=held,
        tolerated=tuple(tolerance),
        components=components,
        search=found,
        outliers=tuple(poses.label[k] for k in outliers),
        rvdt=rvdt,
        assumed=(*arm.assumed, *fixture.give.assumed),
        hand=tip_sigma(model, estimate, q),
        implicit=implicit,
        length_tolerance_m=length_tolerance_m,
        scales=() if judged_paper is not None else learned_scales(whole.linear, whole.found),
        shares=shares,
        distances=distances(model, estimate, poses.placements),
        condition_at_readings=condition_at_readings(alone, in_order(alone, model, estimate.x), q),
        warnings=(),
        reasons=(),
    )
    if judged_paper is None and not unsensed_joints:
        solution = with_best_table(solution, arm, whole, q)
    return with_notices(
        solution,
        arm,
        fixture,
        poses,
        whole=whole,
        judged=judged,
        known=known,
        same=same,
        as_stated=by_files if judged_paper is None else () if drop else blind,
        judgement=judgement,
        limits=limits,
    )


def _outliers(found: Calibrated, of_each: IntArray) -> tuple[int, ...]:
    """Indices of poses whose readings the others do not predict, the worst first.

    `of_each` are the indices of the poses that `found` was made of.
    """
    from scipy.special import chdtrc

    chi2, dof = found.linear.left_out_chi2()
    chances = chdtrc(np.maximum(dof, 1), chi2)
    named = [
        k for k in np.argsort(chances) if chances[k] < OUTLIER_NOTICE_PROBABILITY / len(chances)
    ]
    return tuple(int(of_each[found.order[k]]) for k in named)

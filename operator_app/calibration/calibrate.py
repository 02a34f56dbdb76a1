"""Calibration from a pose set in stages: prepare, fit, collect the results, diagnose, add notices.

Each stage gets the frozen records of earlier stages, and only the options that it needs. The function `calibrate` is
used by the command `sarcal solve`, by the session and by the library.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fixtures.base import EndpointConstraint
from operator_app.calibration import failure_analysis, multistart
from operator_app.calibration.acceptance import Adjudication
from operator_app.calibration.adjudication import PriorInformation, adjudicate
from operator_app.calibration.alternatives import find_alternatives, poses_in_radians
from operator_app.calibration.calibrated_arm import with_best_table
from operator_app.calibration.error_model import (
    averaged_at_rest,
    distinct_poses,
    error_model,
    free_within_tolerance,
    stated_priors,
)
from operator_app.calibration.experiment import (
    Experiment,
    IdentifiableLoops,
    identifiable_loops,
    placement_checks,
    refuse_placement,
    with_angles_of_unsensed,
)
from operator_app.calibration.findings import left_out_poses, pose_labels, range_finding
from operator_app.calibration.instrument_registration import with_registered_instrument
from operator_app.calibration.notices import with_notices
from operator_app.calibration.placements import compared, distances, indistinguishable_placements
from operator_app.calibration.repeat_measurement import RepeatedReading, repeats_of
from operator_app.calibration.result import Solution
from operator_app.calibration.rvdt import check_rvdts, measured_offsets
from operator_app.calibration.tool_accuracy import tip_sigma
from operator_app.config.procedure import AcceptanceLimits
from operator_app.messages.finding import Finding, FindingKind
from operator_app.units import joints_named
from solver.arrays import FloatArray, IntArray, evenly
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics.hypothesis_tests import leave_one_out_chi2
from solver.diagnostics.identifiability import (
    Identifiability,
    condition_at_readings,
    identifiability,
    identifiability_of_fit,
    well_conditioned_at_readings,
)
from solver.diagnostics.limits import (
    CHI2_PER_DOF_GROSS,
    FEW_DOF,
    OUTLIER_NOTICE_PROBABILITY,
)
from solver.diagnostics.range_checks import RangeFinding, ReadingFault, range_findings
from solver.diagnostics.stated_sizes import learned_scales, shares_of_poses
from solver.diagnostics.statistics import chi2_probability
from solver.errors import PosesDoNotFitError, UnidentifiableError
from solver.estimators.error_model import ErrorModel
from solver.estimators.estimate import closure_at_readings, require_enough_poses
from solver.estimators.least_squares import Progress
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import Calibrated
from solver.loops.closure import ClosureModel, in_order

ESTIMATORS = ("implicit", "paper")

MOST_DIAGNOSED_POSES = 2000
"""Largest number of poses, chosen evenly from all, for tests and RVDT verdicts: more do not change a result."""


def calibrate(
    arm: ArmModel,
    fixture: EndpointConstraint,
    poses: PoseSet,
    *,
    estimator: str = "implicit",
    unsensed_joints: tuple[int, ...] = (),
    search: bool = False,
    drop: bool = False,
    length_tolerance_m: float | None = None,
    limits: AcceptanceLimits | None = None,
    rereads: tuple[RepeatedReading, ...] = (),
    progress: Progress | None = None,
) -> Solution:
    """Calibrate `arm` in `fixture` from measured poses.

    `search`: use a global start instead of starting from the nominal values.
    `length_tolerance_m`: standard deviation of the maker's link lengths, used instead of the arm file's.
    `drop`: fix unidentifiable parameters at their nominal values instead of raising an error.
    `rereads`: repeated poses, which are used in tests but not in the fit.

    Raises `ReadingsOutOfRangeError` if the readings are of another arm or in another unit. Raises `TooFewPosesError`,
    `UnidentifiableError`, `FixtureRefusedError`, `EndpointMissingError` or `PosesDoNotFitError` if the data do not
    determine the parameters or do not fit the loops; the error states the cause. Raises `ValueError` if `estimator` is
    unknown, or if the paper's estimator is requested with unsensed joints.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator must be one of {', '.join(ESTIMATORS)}")
    unsensed = tuple(sorted({*unsensed_joints, *arm.unsensed_joints}))
    if estimator == "paper" and unsensed:
        raise ValueError("the paper's estimator needs every joint sensed (eqs. 10-13)")
    poses = with_angles_of_unsensed(arm, fixture, averaged_at_rest(arm, poses))
    experiment = Experiment(
        arm=arm.with_length_tolerance(length_tolerance_m),
        # The instrument's placements that no file states are estimated from the poses.
        fixture=with_registered_instrument(arm, fixture, poses),
        poses=poses,
        unsensed=unsensed,
    )
    by_paper = estimator == "paper"
    prepared = prepare(experiment, by_paper=by_paper, search=search, drop=drop, progress=progress)
    whole, limits = fit(prepared, progress), AcceptanceLimits() if limits is None else limits
    return assess(prepared, whole, rereads, limits, length_tolerance_m)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """Loops of the poses on the main branch, with the model, data and error model of their fit.

    `fixed`: unidentifiable unknowns that stay at their nominal values because the caller set `drop`.
    `free`: model with only the unknowns that the poses have to identify.
    `model`: `free` with further entries of the maker's table, which the fit may correct within a tolerance.
    `errors`: error model of the distinct poses; its `tolerance` names these further entries.
    `distinct`: indices of the distinct poses. `which`: for every pose on the branch, its position in `distinct`.
    `prior`: names of the arm's unknowns in `free` whose uncertainty the arm's file states.
    """

    experiment: Experiment
    by_paper: bool
    out_of_range: tuple[RangeFinding, ...]
    loops: IdentifiableLoops
    fixed: tuple[str, ...]
    free: ClosureModel
    model: ClosureModel
    errors: ErrorModel
    distinct: IntArray
    which: IntArray
    prior: frozenset[str]


def prepare(
    experiment: Experiment, *, by_paper: bool, search: bool, drop: bool, progress: Progress | None
) -> Prepared:
    """Build the loops and the model to be fitted to the poses.

    Raises an error for too few poses, for readings of another arm or in another unit, and for a placement of the
    fixture in which parameters are ambiguous or unidentifiable.
    """
    model, arm, poses = experiment.loop(), experiment.arm, experiment.poses
    require_enough_poses(model, len(poses))
    out_of_range = range_findings(arm, poses, unsensed_joints=experiment.unsensed)
    refuse_placement(experiment, model)
    loops = identifiable_loops(experiment, model, search=search, drop=drop, progress=progress)
    fixed = loops.unidentifiable if drop else ()
    free = loops.identifiable if by_paper else loops.model
    # The implicit fit is always made, because the paper's estimate is compared with it.
    model, tolerance = free_within_tolerance(free, arm, fixed=fixed)
    prior = stated_priors(free, arm, experiment.fixture)
    distinct, which = distinct_poses(poses, loops.kept)
    prepared = Prepared(
        experiment=experiment,
        by_paper=by_paper,
        out_of_range=out_of_range,
        loops=loops,
        fixed=fixed,
        free=free,
        model=model,
        errors=error_model(experiment, distinct, tolerance=tolerance, prior=prior),
        distinct=distinct,
        which=which,
        prior=frozenset(prior) - {*free.ground_side, *free.hand_side},
    )
    # Before the fit, because along an unidentifiable direction without a prior no estimate is valid.
    if (paper := loops.paper) is not None and (
        by_paper or not well_conditioned_at_readings(paper, loops.q)
    ):
        _identifiability(prepared, paper.x)
    return prepared


def fit(prepared: Prepared, progress: Progress | None) -> Calibrated:
    """Fit the distinct poses by the implicit estimator, from several starts.

    Raises `PosesDoNotFitError` if no start leads to a fit; the error lists the alternative models that fit.
    """
    experiment, loops, distinct = prepared.experiment, prepared.loops, prepared.distinct
    rows = np.searchsorted(np.flatnonzero(loops.kept), distinct)
    try:
        return multistart.fit_from_starts(
            prepared.model.at_poses(rows),
            loops.q[rows],
            prepared.errors,
            _starts(prepared),
            group=experiment.poses.placement[distinct],
            progress=progress,
        )
    except PosesDoNotFitError as error:
        unknowns = len(loops.identifiable.parameters)
        dof = len(distinct) * prepared.free.equations_per_pose - unknowns
        stated = experiment.at_poses(distinct)
        raise failure_analysis.poses_do_not_fit(
            poses_in_radians(stated, CHI2_PER_DOF_GROSS)
            or find_alternatives(stated, scale=np.inf, dof=dof)
        ) from error


def assess(
    prepared: Prepared,
    whole: Calibrated,
    rereads: tuple[RepeatedReading, ...],
    limits: AcceptanceLimits,
    length_tolerance_m: float | None,
) -> Solution:
    """Test the implicit fit `whole` and the RVDTs, and return the solution with verdict and notices.

    Raises `UnidentifiableError`, or an error that names its cause, if parameters are unidentifiable at the estimate.
    """
    loops, experiment = prepared.loops, prepared.experiment
    # The same estimate with a linear fit of fewer poses, for the tests.
    part, chosen = whole.few(MOST_DIAGNOSED_POSES)
    tested = prepared.distinct[chosen]
    solution = collect(prepared, whole, part)
    model, x = solution.model, solution.estimate.x
    same: tuple[Finding, ...] = ()
    if multistart.gross_misfit(whole) < CHI2_PER_DOF_GROSS:
        # The loops close well enough to test sensors and compare placements.
        rvdt = check_rvdts(experiment, loops.kept, tested, part, fixed=prepared.fixed)
        solution = replace(solution, rvdt=rvdt)
        same = indistinguishable_placements(prepared.model, whole.estimate)
    left_out, out_of_range = left_out_poses(
        loops.flipped, prepared.out_of_range, experiment.arm, experiment.poses
    )
    known = PriorInformation(
        out_of_range=out_of_range,
        left_out=left_out,
        checks=placement_checks(experiment, model, x),
        returned=repeats_of(rereads, experiment.at_poses(loops.kept), model, x),
    )
    adjudication = adjudicate(solution, part, experiment, tested, known)
    outliers = _outliers(whole, prepared.distinct, experiment.poses, adjudication)
    solution = replace(
        solution,
        adjudication=adjudication,
        outliers=outliers,
        length_tolerance_m=length_tolerance_m,
    )
    by_choice = prepared.by_paper and not prepared.fixed
    return with_notices(
        solution,
        experiment,
        stated=whole.linear.stated,
        tested=part.linear,
        repeats=len(prepared.which) - len(prepared.distinct),
        known=known,
        same=same,
        as_stated=loops.unidentifiable if by_choice else solution.by_files,
        limits=limits,
    )


def collect(prepared: Prepared, whole: Calibrated, part: Calibrated) -> Solution:
    """Return the results of the chosen estimator, without tests, verdict and notices.

    `whole`: implicit fit of the distinct poses. `part`: the same fit, but its linear fit is made from fewer poses.
    """
    loops, experiment, by_paper = prepared.loops, prepared.experiment, prepared.by_paper
    arm, fixture, poses, q = experiment.arm, experiment.fixture, experiment.poses, loops.q
    implicit, components = whole.estimate, whole.components
    if len(prepared.which) != len(prepared.distinct):
        implicit = implicit.at_poses(prepared.which)
        components = components.at_poses(prepared.which)
    model = prepared.free if by_paper else prepared.model
    estimate = (loops.paper if by_paper else None) or implicit
    identifiable_x = in_order(loops.identifiable, model, estimate.x)
    solution = Solution(
        model=model,
        estimate=estimate,
        paper=loops.paper,
        identifiability=_identifiability_of(prepared, part, identifiable_x),
        before=closure_at_readings(model, nominal_vector(model.parameters), q).sigmas,
        poses=len(q),
        dropped_flipped=loops.flipped,
        held=prepared.fixed,
        tolerated=() if by_paper else tuple(prepared.errors.tolerance),
        components=None if by_paper else components,
        search=loops.search,
        outliers=(),
        rvdt=(),
        assumed=(*arm.assumed, *fixture.compliance.assumed),
        hand=tip_sigma(model, estimate, q),
        implicit=implicit.without(tuple(prepared.errors.tolerance)) if by_paper else None,
        unsensed_offsets=measured_offsets(model, estimate.x, q, arm),
        scales=() if by_paper else learned_scales(whole.linear, whole.derivatives),
        shares={} if by_paper else shares_of_poses(whole.linear),
        distances=distances(
            model,
            estimate.x,
            estimate.covariance,
            poses.placements,
            () if by_paper else compared(experiment, whole.linear),
        ),
        condition_at_readings=condition_at_readings(loops.identifiable, identifiable_x, q),
        warnings=(),
        reasons=(),
    )
    if by_paper or experiment.unsensed:
        return solution
    return with_best_table(solution, arm, whole, q)


def _identifiability(prepared: Prepared, x: FloatArray) -> Identifiability:
    """Return the identifiability at parameters `x`, from the loop closure, or raise an error if it does not suffice."""
    loops, sigma_rad = prepared.loops, prepared.experiment.arm.sigma_rad()
    identified = identifiability(loops.identifiable, x, loops.q, sigma_rad=sigma_rad)
    return _require_identifiable(prepared, identified)


def _require_identifiable(prepared: Prepared, identified: Identifiability) -> Identifiability:
    """Return `identified`, or raise an error that names the unidentifiable directions or the cause.

    The implicit estimator accepts a direction if the arm's file states the uncertainty of one of its parameters.
    """
    experiment, loops, model = prepared.experiment, prepared.loops, prepared.free
    known = frozenset[str]() if prepared.by_paper else prepared.prior
    blind = tuple(d for d in identified.directions if not known & set(d.parameters))
    if not blind:
        return identified
    error, poses = UnidentifiableError(blind), len(loops.q)
    if poses * model.equations_per_pose - len(model.parameters) < FEW_DOF:
        note = f"{poses} poses are few: take at least 20"
        error = UnidentifiableError(blind, code="TOO_FEW_POSES", note=note)
    elif unsensed := experiment.unsensed:
        note = (
            f"the calibration uses no reading of {joints_named(unsensed)}: other poses may not help"
        )
        error = UnidentifiableError(blind, note=note)
    saturated = (f for f in prepared.out_of_range if f.fault is ReadingFault.SATURATED)
    raise failure_analysis.explain_unidentifiable(
        error,
        experiment.at_poses(loops.kept),
        loops.paper,
        tuple(range_finding(f, experiment) for f in saturated),
    )


def _identifiability_of(prepared: Prepared, part: Calibrated, x: FloatArray) -> Identifiability:
    """Return the identifiability at the estimate `x` of the identifiable parameters."""
    loops = prepared.loops
    if prepared.by_paper or loops.paper is None:
        # With unsensed joints, too, the loop closure is used instead of the linear fit.
        return _identifiability(prepared, x)
    names = tuple(p.name for p in loops.identifiable.parameters)
    identified = identifiability_of_fit(part.linear, names, taken=part.order)
    return _require_identifiable(prepared, identified)


def _starts(prepared: Prepared) -> Iterator[FloatArray | None]:
    """Yield start values (P,) for the implicit fit, in the order to be tried; None lets the fit find a start."""
    loops, unsensed = prepared.loops, prepared.experiment.unsensed
    model, q, identifiable = prepared.model, loops.q, loops.identifiable
    if prepared.prior and loops.search is None and not unsensed:
        # The fixture's placement alone, with the arm's stated entries at their nominal values.
        fixture_only = prepared.free.without(prepared.prior)
        yield in_order(model, fixture_only, estimate_paper(fixture_only, q).x)
    first = loops.paper or loops.search
    yield None if first is None else in_order(model, identifiable, first.x)
    yield nominal_vector(model.parameters)
    if not unsensed:
        few = evenly(len(q), multistart.SCREENING_POSES)
        best = multistart.best_about_nominal(identifiable.at_poses(few), q[few])
        yield in_order(model, identifiable, best)


def _outliers(
    calibrated: Calibrated, of_each: IntArray, poses: PoseSet, adjudication: Adjudication
) -> tuple[str, ...]:
    """Return the labels of the outliers that prevent acceptance.

    If there are none, return the labels of the poses that the other poses do not predict, the worst first.
    `of_each`: for each pose of `calibrated`, its index in `poses`.
    """
    for cause in adjudication.causes:
        if cause.kind is FindingKind.OUTLIERS and cause.blocking:
            labels = pose_labels(poses)
            return tuple(poses.label[labels.index(n)] for n in cause.poses if n in labels)
    fit = calibrated.linear
    each = (leave_one_out_chi2(fit.orthonormal(part), fit.residual(part)) for part in fit.parts())
    chi2, dof = (np.concatenate(values) for values in zip(*each, strict=True))
    chances = chi2_probability(np.maximum(dof, 1), chi2)
    limit = OUTLIER_NOTICE_PROBABILITY / len(chances)
    named = (k for k in np.argsort(chances) if chances[k] < limit)
    return tuple(poses.label[of_each[calibrated.order[k]]] for k in named)

"""Calibration from a pose set in stages: prepare, fit, diagnose, collect the results, add notices.

Each stage gets the frozen records of earlier stages, and only the options that it needs. The function `calibrate` is
used by the command `sarcal solve`, by the session and by the library.
"""

from collections.abc import Iterator, Mapping
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
from operator_app.messages.finding import FindingKind
from operator_app.units import joints_named
from solver.arrays import FloatArray, IntArray, evenly
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
    FEW_DOF,
    LEAST_INFORMATION_SHARE,
    OUTLIER_NOTICE_PROBABILITY,
)
from solver.diagnostics.range_checks import RangeFinding, ReadingFault, range_findings
from solver.diagnostics.stated_sizes import learned_scales, shares_of_poses
from solver.errors import PosesDoNotFitError, UnidentifiableError
from solver.estimators.error_model import ErrorModel
from solver.estimators.estimate import Estimate, closure_at_readings, require_enough_poses
from solver.estimators.least_squares import Progress
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import Calibrated, VarianceComponents
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
    fitted = fit(prepared, progress)
    known, adjudication = diagnose(fitted, rereads)
    solution = collect(fitted, known, adjudication, length_tolerance_m)
    unidentifiable = () if drop else prepared.loops.unidentifiable
    return with_notices(
        solution,
        experiment,
        whole=fitted.whole,
        tested=fitted.part,
        repeats=len(prepared.which) - len(prepared.distinct),
        known=known,
        same=indistinguishable_placements(prepared.model, fitted.whole.estimate)
        if fitted.closes
        else (),
        as_stated=unidentifiable if by_paper else known.by_files,
        limits=AcceptanceLimits() if limits is None else limits,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """Loops of the poses on the main branch, with the model, data and error model of their fit.

    `fixed`: unidentifiable unknowns that stay at their nominal values because the caller set `drop`.
    `hard`: model with only the unknowns that the poses have to identify.
    `model`: `hard` with further entries of the maker's table, which the fit may correct within a tolerance.
    `tolerance`: standard deviation (rad, m) of each of these further entries, by name.
    `errors`: error model of the distinct poses.
    `distinct`: indices of the distinct poses. `which`: for every pose on the branch, its position in `distinct`.
    `prior`: names of the arm's unknowns in `hard` whose uncertainty the arm's file states.
    `identifiability`: identifiability at the paper's estimate; None if it was not evaluated.
    """

    experiment: Experiment
    by_paper: bool
    out_of_range: tuple[RangeFinding, ...]
    loops: IdentifiableLoops
    fixed: tuple[str, ...]
    hard: ClosureModel
    model: ClosureModel
    tolerance: Mapping[str, float]
    errors: ErrorModel
    distinct: IntArray
    which: IntArray
    prior: frozenset[str]
    identifiability: Identifiability | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """The implicit fit, and the result of the chosen estimator (`estimate`).

    `whole`: implicit fit of the distinct poses. `part`: the same estimate with a linear fit of at most
    `MOST_DIAGNOSED_POSES` poses, for the tests. `tested`: indices of these poses.
    `shares`: share of each parameter's information that comes from the poses; empty with the paper's estimator.
    """

    prepared: Prepared
    whole: Calibrated
    part: Calibrated
    tested: IntArray
    model: ClosureModel
    tolerance: Mapping[str, float]
    estimate: Estimate
    components: VarianceComponents | None
    implicit: Estimate | None
    identifiability: Identifiability
    shares: Mapping[str, float]

    @property
    def closes(self) -> bool:
        """Whether the loops close well enough to test sensors and compare placements."""
        return multistart.gross_misfit(self.whole) < CHI2_PER_DOF_GROSS


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
    hard = loops.identifiable if by_paper else loops.model
    # The implicit fit is always made, because the paper's estimate is compared with it.
    model, tolerance = free_within_tolerance(hard, arm, fixed=fixed)
    prior = stated_priors(hard, arm, experiment.fixture)
    distinct, which = distinct_poses(poses, loops.kept)
    prepared = Prepared(
        experiment=experiment,
        by_paper=by_paper,
        out_of_range=out_of_range,
        loops=loops,
        fixed=fixed,
        hard=hard,
        model=model,
        tolerance=tolerance,
        errors=error_model(experiment, distinct, tolerance=tolerance, prior=prior),
        distinct=distinct,
        which=which,
        prior=frozenset(prior) - {*hard.ground_side, *hard.hand_side},
    )
    # Before the fit, because along an unidentifiable direction without a prior no estimate is valid.
    if (paper := loops.paper) is not None and (
        by_paper or not well_conditioned_at_readings(paper, loops.q)
    ):
        return replace(prepared, identifiability=_identifiability(prepared, paper.x))
    return prepared


def fit(prepared: Prepared, progress: Progress | None) -> Fitted:
    """Fit by the implicit estimator from several starts; return the fit and the estimate of the chosen estimator.

    Raises `PosesDoNotFitError` if no start leads to a fit; the error lists the alternative models that fit. Raises
    `UnidentifiableError`, or an error that names its cause, if parameters are unidentifiable at the estimate.
    """
    experiment, loops, distinct = prepared.experiment, prepared.loops, prepared.distinct
    rows = np.searchsorted(np.flatnonzero(loops.kept), distinct)
    try:
        calibrated = multistart.fit_from_starts(
            prepared.model.at_poses(rows),
            loops.q[rows],
            prepared.errors,
            _starts(prepared),
            group=experiment.poses.placement[distinct],
            progress=progress,
        )
    except PosesDoNotFitError as error:
        unknowns = len(loops.identifiable.parameters)
        dof = len(distinct) * prepared.hard.equations_per_pose - unknowns
        stated = experiment.at_poses(distinct)
        raise failure_analysis.poses_do_not_fit(
            poses_in_radians(stated, CHI2_PER_DOF_GROSS)
            or find_alternatives(stated, scale=np.inf, dof=dof)
        ) from error
    estimate, components = calibrated.estimate, calibrated.components
    if len(prepared.which) != len(distinct):
        estimate = estimate.at_poses(prepared.which)
        components = components.at_poses(prepared.which)
    part, chosen = calibrated.few(MOST_DIAGNOSED_POSES)
    paper = loops.paper if prepared.by_paper else None
    return Fitted(
        prepared=prepared,
        whole=calibrated,
        part=part,
        tested=distinct[chosen],
        model=prepared.model if paper is None else prepared.hard,
        tolerance=prepared.tolerance if paper is None else {},
        estimate=estimate if paper is None else paper,
        components=components if paper is None else None,
        implicit=None if paper is None else estimate.without(tuple(prepared.tolerance)),
        identifiability=_identifiability_of(prepared, part, estimate.x),
        shares={} if prepared.by_paper else shares_of_poses(calibrated.linear),
    )


def diagnose(
    fitted: Fitted, rereads: tuple[RepeatedReading, ...]
) -> tuple[PriorInformation, Adjudication]:
    """Test the fit, the RVDTs, the fixture's geometry and repeated poses; return these results and the adjudication."""
    prepared, model, x = fitted.prepared, fitted.model, fitted.estimate.x
    loops, experiment = prepared.loops, prepared.experiment
    part, tested, shares = fitted.part, fitted.tested, fitted.shares
    unknowns = tuple(p.name for p in prepared.hard.parameters)
    left_out, out_of_range = left_out_poses(
        loops.flipped, prepared.out_of_range, experiment.arm, experiment.poses
    )
    known = PriorInformation(
        judged=unknowns,
        paper=fitted.estimate if prepared.by_paper else None,
        out_of_range=out_of_range,
        flipped=len(loops.flipped),
        left_out=left_out,
        checks=placement_checks(experiment, model, x),
        search=loops.search,
        rvdt=check_rvdts(experiment, loops.kept, tested, part, fixed=prepared.fixed)
        if fitted.closes
        else (),
        returned=repeats_of(rereads, experiment.at_poses(loops.kept), model, x),
        by_files=tuple(n for n in unknowns if shares.get(n, 1.0) < LEAST_INFORMATION_SHARE),
    )
    return known, adjudicate(part, experiment, tested, known)


def collect(
    fitted: Fitted,
    known: PriorInformation,
    adjudication: Adjudication,
    length_tolerance_m: float | None,
) -> Solution:
    """Collect the results of a calibration, without its notices."""
    prepared, calibrated, by_paper = fitted.prepared, fitted.whole, fitted.prepared.by_paper
    loops, experiment = prepared.loops, prepared.experiment
    model, estimate, q = fitted.model, fitted.estimate, loops.q
    arm, fixture, poses = experiment.arm, experiment.fixture, experiment.poses
    solution = Solution(
        model=model,
        estimate=estimate,
        paper=loops.paper,
        identifiability=fitted.identifiability,
        before=closure_at_readings(model, nominal_vector(model.parameters), q).sigmas,
        poses=len(q),
        dropped_flipped=loops.flipped,
        held=prepared.fixed,
        tolerated=tuple(fitted.tolerance),
        components=fitted.components,
        search=loops.search,
        outliers=_outliers(calibrated, prepared.distinct, poses, adjudication),
        rvdt=known.rvdt,
        assumed=(*arm.assumed, *fixture.compliance.assumed),
        hand=tip_sigma(model, estimate, q),
        implicit=fitted.implicit,
        unsensed_offsets=measured_offsets(model, estimate.x, q, arm),
        length_tolerance_m=length_tolerance_m,
        scales=() if by_paper else learned_scales(calibrated.linear, calibrated.derivatives),
        shares=fitted.shares,
        distances=distances(
            model,
            estimate.x,
            estimate.covariance,
            poses.placements,
            () if by_paper else compared(experiment, calibrated.linear),
        ),
        condition_at_readings=condition_at_readings(
            loops.identifiable, in_order(loops.identifiable, model, estimate.x), q
        ),
        adjudication=adjudication,
        warnings=(),
        reasons=(),
    )
    if by_paper or experiment.unsensed:
        return solution
    return with_best_table(solution, arm, calibrated, q)


def _identifiability(prepared: Prepared, x: FloatArray) -> Identifiability:
    """Return the identifiability at parameters `x`, from the loop closure, or raise an error if it does not suffice."""
    loops, sigma_rad = prepared.loops, prepared.experiment.arm.sigma_rad()
    identified = identifiability(loops.identifiable, x, loops.q, sigma_rad=sigma_rad)
    return _require_identifiable(prepared, identified)


def _require_identifiable(prepared: Prepared, identified: Identifiability) -> Identifiability:
    """Return `identified`; if parameters are unidentifiable, raise an error with the directions or their cause.

    The implicit estimator accepts a direction if the arm's file states the uncertainty of a parameter in it.
    """
    experiment, loops, model = prepared.experiment, prepared.loops, prepared.hard
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
        tuple(range_finding(f, experiment.poses) for f in saturated),
    )


def _identifiability_of(prepared: Prepared, part: Calibrated, x: FloatArray) -> Identifiability:
    """Return the identifiability at the chosen estimate; with unsensed joints, at the implicit estimate `x` (P,)."""
    loops = prepared.loops
    if prepared.by_paper and prepared.identifiability is not None:
        return prepared.identifiability
    if loops.paper is None:
        # Some joints are unsensed: the loop closure is used instead of the linear fit.
        return _identifiability(prepared, in_order(loops.identifiable, prepared.model, x))
    names = tuple(p.name for p in loops.identifiable.parameters)
    identified = identifiability_of_fit(part.linear, names, taken=part.order)
    return _require_identifiable(prepared, identified)


def _starts(prepared: Prepared) -> Iterator[FloatArray | None]:
    """Yield start values (P,) for the implicit fit, in the order to be tried; None lets the fit find a start."""
    loops, unsensed = prepared.loops, prepared.experiment.unsensed
    model, q, identifiable = prepared.model, loops.q, loops.identifiable
    if prepared.prior and loops.search is None and not unsensed:
        # The fixture's placement alone, with the arm's stated entries at their nominal values.
        fixture_only = prepared.hard.without(prepared.prior)
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
    from scipy.special import chdtrc

    for cause in adjudication.causes:
        if cause.kind is FindingKind.OUTLIERS and cause.blocking:
            labels = pose_labels(poses)
            return tuple(poses.label[labels.index(n)] for n in cause.poses if n in labels)
    chi2, dof = calibrated.linear.left_out_chi2()
    chances = chdtrc(np.maximum(dof, 1), chi2)
    limit = OUTLIER_NOTICE_PROBABILITY / len(chances)
    named = (k for k in np.argsort(chances) if chances[k] < limit)
    return tuple(poses.label[of_each[calibrated.order[k]]] for k in named)

"""Calibration from a pose set in stages: prepare, screen, fit, diagnose, decide.

Each stage takes one frozen record and returns the next. `sarcal solve`, the session and the library call this.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fixtures.base import EndpointConstraint
from operator_app.calibration.acceptance import Adjudication
from operator_app.calibration.adjudication import PriorInformation, adjudicate
from operator_app.calibration.alternatives import find_alternatives
from operator_app.calibration.calibrated_arm import with_best_table
from operator_app.calibration.closed_loops import (
    IdentifiableLoops,
    identifiable_loops,
    in_order,
    placement_checks,
    refuse_placement,
)
from operator_app.calibration.error_model import (
    distinct_poses,
    error_model,
    free_within_tolerance,
    stated_priors,
)
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.failure_analysis import (
    explain_unidentifiable,
    poses_do_not_fit,
    saturated_readings,
)
from operator_app.calibration.instrument_registration import with_registered_instrument
from operator_app.calibration.multistart import (
    SCREENING_POSES,
    best_about_nominal,
    evenly,
    fit_from_starts,
    gross_misfit,
)
from operator_app.calibration.notices import with_notices
from operator_app.calibration.placements import compared, distances, indistinguishable_placements
from operator_app.calibration.repeat_measurement import RepeatedReading, repeats_of
from operator_app.calibration.result import Solution
from operator_app.calibration.rvdt import check_rvdts
from operator_app.calibration.tool_accuracy import tip_sigma
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
    FEW_DOF,
    LEAST_INFORMATION_SHARE,
    OUTLIER_NOTICE_PROBABILITY,
)
from solver.diagnostics.range_checks import RangeFinding, range_findings
from solver.diagnostics.stated_sizes import learned_scales, shares_of_poses
from solver.errors import PosesDoNotFitError, UnidentifiableError
from solver.estimators.error_model import ErrorModel
from solver.estimators.estimate import Estimate, closure_at_readings, require_enough_poses
from solver.estimators.least_squares import Progress
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import Calibrated, VarianceComponents
from solver.loops.closure import ClosureModel

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

    Raises `ReadingsOutOfRangeError` if the readings are of another arm, or in another unit; `TooFewPosesError`,
    `UnidentifiableError`, `FixtureRefusedError`, `EndpointMissingError` or `PosesDoNotFitError`, with the cause, if the
    data do not determine the parameters or do not fit the loops; `ValueError` if `estimator` is unknown, or if the
    paper's estimator is requested with unsensed joints.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator must be one of {', '.join(ESTIMATORS)}")
    unsensed = tuple(sorted({*unsensed_joints, *arm.unsensed_joints}))
    if estimator == "paper" and unsensed:
        raise ValueError("the paper's estimator needs every joint sensed (eqs. 10-13)")
    fixture = with_registered_instrument(arm, fixture, poses)
    arm = arm.with_length_tolerance(length_tolerance_m)
    task = Task(
        experiment=Experiment(arm=arm, fixture=fixture, poses=poses, unsensed=unsensed),
        by_paper=estimator == "paper",
        search=search,
        drop=drop,
        length_tolerance_m=length_tolerance_m,
        limits=AcceptanceLimits() if limits is None else limits,
        rereads=rereads,
        progress=progress,
    )
    return decide(diagnose(fit(screen(prepare(task)))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """The checked arguments of `calibrate`; an instrument's unknown placements are estimated from the poses."""

    experiment: Experiment
    by_paper: bool
    search: bool
    drop: bool
    length_tolerance_m: float | None
    limits: AcceptanceLimits
    rereads: tuple[RepeatedReading, ...]
    progress: Progress | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """Loops of the poses on one branch, the model with the unknowns to identify (`hard`), and readings out of range."""

    task: Task
    loops: IdentifiableLoops
    hard: ClosureModel
    out_of_range: tuple[RangeFinding, ...]

    @property
    def dropped(self) -> tuple[str, ...]:
        """Unknowns that are fixed at their nominal values on request."""
        return self.loops.unidentifiable if self.task.drop else ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Screened:
    """Model, data and error model of the fit.

    `model`: the loops with all free parameters.
    `tolerance`: tolerance (rad, m), by name, of each entry free within a tolerance.
    `errors`: error model of the distinct poses.
    `distinct`, `which`: indices of the distinct poses; for every pose on the branch, its position among them.
    `prior`: names of the arm's entries whose uncertainty the arm's file states.
    `identifiability`: identifiability at the paper's estimate; None if it was not evaluated.
    """

    before: Prepared
    model: ClosureModel
    tolerance: Mapping[str, float]
    errors: ErrorModel
    distinct: IntArray
    which: IntArray
    prior: frozenset[str]
    identifiability: Identifiability | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """The implicit fit of the distinct poses (`whole`), and the chosen estimator's result from all poses."""

    before: Screened
    whole: Calibrated
    model: ClosureModel
    tolerance: Mapping[str, float]
    estimate: Estimate
    components: VarianceComponents | None
    implicit: Estimate | None

    @property
    def closes(self) -> bool:
        """Whether the loops close well enough to test sensors and compare placements."""
        return gross_misfit(self.whole) < CHI2_PER_DOF_GROSS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosed:
    """Results of the tests of a fit; `part`: the fit of the poses that were tested."""

    before: Fitted
    part: Calibrated
    identifiability: Identifiability
    shares: Mapping[str, float]
    known: PriorInformation
    adjudication: Adjudication


def prepare(task: Task) -> Prepared:
    """Build the loops; refuse too few poses, readings out of range, and placements with ambiguous parameters."""
    experiment, model = task.experiment, task.experiment.loop()
    poses, unsensed = experiment.poses, experiment.unsensed
    require_enough_poses(model, len(poses))
    out_of_range = range_findings(experiment.arm, poses, unsensed_joints=unsensed)
    refuse_placement(experiment, model)
    loops = identifiable_loops(
        experiment, model, search=task.search, drop=task.drop, progress=task.progress
    )
    hard = loops.identifiable if task.by_paper else loops.model
    return Prepared(task=task, loops=loops, hard=hard, out_of_range=out_of_range)


def screen(prepared: Prepared) -> Screened:
    """Refuse unidentifiable parameters, add entries with a tolerance to the unknowns, and collect the error model."""
    task, loops, hard = prepared.task, prepared.loops, prepared.hard
    experiment = task.experiment
    prior = stated_priors(hard, experiment.arm, experiment.fixture)
    by_arm = frozenset(prior) - {*hard.ground_side, *hard.hand_side}
    at_readings = None
    # Before the fit, because along an unidentifiable direction without a prior no estimate is valid.
    if (paper := loops.paper) is not None and (
        task.by_paper or not well_conditioned_at_readings(paper, loops.q)
    ):
        at_readings = _identifiability(prepared, paper.x)
        _require_identifiable(prepared, at_readings, by_arm)
    # The implicit fit is always made, because the paper's estimate is compared with it.
    model, tolerance = free_within_tolerance(hard, experiment.arm, fixed=prepared.dropped)
    distinct, which = distinct_poses(experiment.poses, loops.kept)
    return Screened(
        before=prepared,
        model=model,
        tolerance=tolerance,
        errors=error_model(experiment, distinct, tolerance=tolerance, prior=prior),
        distinct=distinct,
        which=which,
        prior=by_arm,
        identifiability=at_readings,
    )


def fit(screened: Screened) -> Fitted:
    """Fit by the implicit estimator from several starts; return the paper's estimate if that estimator is chosen.

    Raises `PosesDoNotFitError` if no start leads to a fit; the error lists the alternative models that fit.
    """
    prepared, distinct = screened.before, screened.distinct
    task, loops = prepared.task, prepared.loops
    rows = np.searchsorted(np.flatnonzero(loops.kept), distinct)
    try:
        calibrated = fit_from_starts(
            screened.model.at_poses(rows),
            loops.q[rows],
            screened.errors,
            _starts(screened),
            group=task.experiment.poses.placement[distinct],
            progress=task.progress,
        )
    except PosesDoNotFitError as error:
        unknowns = len(loops.identifiable.parameters)
        dof = len(distinct) * prepared.hard.equations_per_pose - unknowns
        stated = task.experiment.at_poses(distinct)
        raise poses_do_not_fit(find_alternatives(stated, scale=np.inf, dof=dof)) from error
    estimate, components = calibrated.estimate, calibrated.components
    if len(screened.which) != len(distinct):
        estimate = estimate.at_poses(screened.which)
        components = components.at_poses(screened.which)
    paper = loops.paper if task.by_paper else None
    return Fitted(
        before=screened,
        whole=calibrated,
        model=screened.model if paper is None else prepared.hard,
        tolerance=screened.tolerance if paper is None else {},
        estimate=estimate if paper is None else paper,
        components=components if paper is None else None,
        implicit=None if paper is None else estimate.without(tuple(screened.tolerance)),
    )


def diagnose(fitted: Fitted) -> Diagnosed:
    """Test the fit and every RVDT, compare placements and repeated poses, and rank the causes."""
    screened, calibrated, model = fitted.before, fitted.whole, fitted.model
    prepared = screened.before
    task, loops, experiment = prepared.task, prepared.loops, prepared.task.experiment
    part, chosen = calibrated.few(MOST_DIAGNOSED_POSES)
    used = screened.distinct[chosen]
    unknowns = tuple(p.name for p in prepared.hard.parameters)
    shares = {} if task.by_paper else shares_of_poses(calibrated.linear)
    identified = _identifiability_of(fitted, part)
    known = PriorInformation(
        out_of_range=prepared.out_of_range,
        flipped=loops.flipped,
        checks=placement_checks(experiment, model, fitted.estimate.x),
        search=loops.search,
        rvdt=check_rvdts(experiment, loops.kept, used, part, fixed=prepared.dropped)
        if fitted.closes
        else (),
        returned=repeats_of(
            task.rereads, experiment.at_poses(loops.kept), model, fitted.estimate.x
        ),
        by_files=tuple(n for n in unknowns if shares.get(n, 1.0) < LEAST_INFORMATION_SHARE),
    )
    return Diagnosed(
        before=fitted,
        part=part,
        identifiability=identified,
        shares=shares,
        known=known,
        adjudication=adjudicate(
            part,
            experiment,
            used,
            judged=unknowns,
            known=known,
            paper=fitted.estimate if task.by_paper else None,
        ),
    )


def decide(diagnosed: Diagnosed) -> Solution:
    """Collect the results of a calibration, its verdict and every notice."""
    fitted, known = diagnosed.before, diagnosed.known
    prepared = fitted.before.before
    task, loops, calibrated = prepared.task, prepared.loops, fitted.whole
    model, estimate, q, experiment = fitted.model, fitted.estimate, loops.q, task.experiment
    arm, fixture, poses = experiment.arm, experiment.fixture, experiment.poses
    solution = Solution(
        model=model,
        estimate=estimate,
        paper=loops.paper,
        identifiability=diagnosed.identifiability,
        before=closure_at_readings(model, nominal_vector(model.parameters), q).sigmas,
        poses=len(q),
        dropped_flipped=loops.flipped,
        held=prepared.dropped,
        tolerated=tuple(fitted.tolerance),
        components=fitted.components,
        search=loops.search,
        outliers=tuple(poses.label[k] for k in _outliers(calibrated, fitted.before.distinct)),
        rvdt=known.rvdt,
        assumed=(*arm.assumed, *fixture.compliance.assumed),
        hand=tip_sigma(model, estimate, q),
        implicit=fitted.implicit,
        length_tolerance_m=task.length_tolerance_m,
        scales=() if task.by_paper else learned_scales(calibrated.linear, calibrated.derivatives),
        shares=diagnosed.shares,
        distances=distances(
            model,
            estimate,
            poses.placements,
            () if task.by_paper else compared(fixture, poses, calibrated.linear),
        ),
        condition_at_readings=condition_at_readings(
            loops.identifiable, in_order(loops.identifiable, model, estimate.x), q
        ),
        warnings=(),
        reasons=(),
    )
    if not task.by_paper and not experiment.unsensed:
        solution = with_best_table(solution, arm, calibrated, q)
    unidentifiable = () if task.drop else loops.unidentifiable
    return with_notices(
        solution,
        experiment,
        whole=calibrated,
        judged=diagnosed.part,
        known=known,
        same=indistinguishable_placements(fitted.before.model, calibrated.estimate)
        if fitted.closes
        else (),
        as_stated=unidentifiable if task.by_paper else known.by_files,
        adjudication=diagnosed.adjudication,
        limits=task.limits,
    )


def _identifiability(prepared: Prepared, x: FloatArray) -> Identifiability:
    loops, sigma_rad = prepared.loops, prepared.task.experiment.arm.sigma_rad()
    return identifiability(loops.identifiable, x, loops.q, sigma_rad=sigma_rad)


def _require_identifiable(
    prepared: Prepared, identified: Identifiability, prior: frozenset[str]
) -> None:
    """Raise an error that names the unidentifiable directions, or the fault that causes them.

    The implicit estimator accepts directions that involve a parameter in `prior` (uncertainty stated in the arm file).
    """
    task, loops, model = prepared.task, prepared.loops, prepared.hard
    known = frozenset[str]() if task.by_paper else prior
    blind = tuple(d for d in identified.directions if not known & set(d.parameters))
    if not blind:
        return
    error, poses = UnidentifiableError(blind), len(loops.q)
    if poses * model.equations_per_pose - len(model.parameters) < FEW_DOF:
        note = f"{poses} poses are few: take at least 20"
        error = UnidentifiableError(blind, code="TOO_FEW_POSES", note=note)
    raise explain_unidentifiable(
        error,
        task.experiment.at_poses(loops.kept),
        loops.paper,
        saturated_readings(prepared.out_of_range, task.experiment.poses),
    )


def _identifiability_of(fitted: Fitted, part: Calibrated) -> Identifiability:
    """Identifiability at the fitted parameters, from the fit's equations or, with unsensed joints, the loop closure."""
    screened = fitted.before
    prepared = screened.before
    loops = prepared.loops
    if prepared.task.by_paper and screened.identifiability is not None:
        return screened.identifiability
    if loops.paper is not None:
        names = tuple(p.name for p in loops.identifiable.parameters)
        identified = identifiability_of_fit(part.linear, names, taken=part.order)
    else:
        x = in_order(loops.identifiable, screened.model, fitted.estimate.x)
        identified = _identifiability(prepared, x)
    _require_identifiable(prepared, identified, screened.prior)
    return identified


def _starts(screened: Screened) -> Iterator[FloatArray | None]:
    """Yield start values: fixture fitted alone, first estimate, nominal values, best solution near nominal values."""
    prepared, model = screened.before, screened.model
    loops, task, unsensed = prepared.loops, prepared.task, prepared.task.experiment.unsensed
    q, identifiable = loops.q, loops.identifiable
    if screened.prior and not task.search and not unsensed:
        # The fixture's placement alone, with the arm's stated entries at their nominal values.
        fixture_only = prepared.hard.without(screened.prior)
        yield in_order(model, fixture_only, estimate_paper(fixture_only, q).x)
    first = loops.paper or loops.search
    yield None if first is None else in_order(model, identifiable, first.x)
    yield nominal_vector(model.parameters)
    if not unsensed:
        few = evenly(len(q), SCREENING_POSES)
        yield in_order(model, identifiable, best_about_nominal(identifiable.at_poses(few), q[few]))


def _outliers(calibrated: Calibrated, of_each: IntArray) -> tuple[int, ...]:
    """Poses that the others do not predict, the worst first; `of_each`: indices of the poses of `calibrated`."""
    from scipy.special import chdtrc

    chi2, dof = calibrated.linear.left_out_chi2()
    chances = chdtrc(np.maximum(dof, 1), chi2)
    limit = OUTLIER_NOTICE_PROBABILITY / len(chances)
    named = (k for k in np.argsort(chances) if chances[k] < limit)
    return tuple(int(of_each[calibrated.order[k]]) for k in named)

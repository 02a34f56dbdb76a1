"""Prediction of new poses from a calibration's own poses, with one error model for both."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from operator_app.calibration.calibrated_arm import with_estimated_place
from operator_app.calibration.error_model import (
    averaged_at_rest,
    distinct_poses,
    error_model,
    free_within_tolerance,
    freed,
    stated_priors,
)
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.result import Solution
from operator_app.units import SLIP_SIGMA
from solver.arrays import BoolArray, FloatArray, IntArray, evenly
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet, canonical_order
from solver.diagnostics.cross_validation import NOT_KNOWN, CommonShift, predicted_residuals
from solver.diagnostics.limits import STATED_VARIANCE_SHARE
from solver.diagnostics.statistics import Chi2Test, chi2_test
from solver.diagnostics.whitened_residuals import WhitenedResiduals
from solver.errors import PosesDoNotFitError
from solver.estimators.effects import Linearisation, LinearModel
from solver.estimators.error_model import ErrorModel
from solver.estimators.estimate import Estimate
from solver.estimators.layout import Layout
from solver.estimators.linear_fit import LinearFit
from solver.estimators.mixed_fit import MixedFit, fit_mixed, gravity_share
from solver.loops.closure import ClosureModel

MOST = 1000
"""Largest number of poses of a calibration, chosen evenly from all, used for a prediction: more do not improve it."""

FIXTURE = "fixture"
"""`CommonShift.subject` of a shift of the fixture; otherwise the subject is the number of a joint."""


def shift_in_words(shift: CommonShift, *, instrument: bool) -> str:
    """Return the text on a shift that all new poses have in common: what shifted, how far, and the remedy.

    `instrument`: whether an instrument measured the open arm, so that no fixture can have moved.
    """
    what = "the arm's base or the instrument" if instrument else "the fixture"
    if shift.subject == FIXTURE or shift.size is None or shift.sigma is None:
        remedy = "give these poses another placement number" if instrument else "calibrate again"
        return (
            f"in all these poses {what} is not where the calibration found it: if it was moved or remounted since, "
            f"{remedy}"
        )
    turned = f", or {what} has turned about the axis of joint 1" if shift.subject == "1" else ""
    more = "more" if shift.size > 0.0 else "less"
    return (
        f"joint {shift.subject} reads {SLIP_SIGMA(abs(shift.size)).with_unit} {more} than the calibration predicts "
        f"(sigma {SLIP_SIGMA(shift.sigma).with_unit}) in all these poses: its offset is wrong, or the "
        f"joint has slipped since the calibration{turned}. Check the coupling and the counter of joint "
        f"{shift.subject}, then calibrate again"
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointLoops:
    """Loops of a calibration's poses and of new poses, and the parameters as calibrated.

    `experiment`: the calibration's distinct poses, then the new poses. `later` (m,): mask of the new poses.
    `x` (P,), `covariance` (P, P): values of the parameters, rad and m, and their covariance.
    `unknown`: names of the parameters of uncalibrated placements. Their values fit the new poses; their standard
    deviation is `NOT_KNOWN`.
    """

    experiment: Experiment
    later: BoolArray
    model: ClosureModel
    x: FloatArray
    covariance: FloatArray
    unknown: tuple[str, ...]


def joint_loops(
    new: Experiment, solution: Solution, made_from: PoseSet, *, elsewhere: bool
) -> JointLoops:
    """Return the loops of the poses of the calibration, `made_from`, and of new poses; flipped poses are left out.

    `elsewhere`: whether the new poses may be in placements that were not calibrated. Raises `ValueError` if it is false
    and they are in such a placement, or if the calibration has a parameter that the loops do not have.
    """
    others = [k for k in new.poses.placements if k not in made_from.placements]
    if others and not elsewhere:
        raise ValueError(f"placement {others[0]} was not calibrated")
    old = _used(solution, averaged_at_rest(new.arm, made_from))
    both = replace(new, poses=concatenated_poses(old, new.poses))
    later = np.arange(len(both.poses)) >= len(old)
    loop, estimate = both.loop(), solution.estimate
    listed = {p.name for p in loop.parameters}
    if len(both.poses.placements) > 1 and len(old.placements) == 1:
        # With the new poses there are several placements, so that parameter names get a placement number.
        (number,) = old.placements
        numbered = (
            replace(p, name=name) if (name := f"{p.name}[{number}]") in listed else p
            for p in estimate.parameters
        )
        estimate = replace(estimate, parameters=tuple(numbered))
    # Placements without any of these poses are left out.
    absent = [p.name for p in estimate.parameters if "[" in p.name and p.name not in listed]
    ends = tuple(f"[{k}]" for k in others)
    unknown = tuple(n for n in loop.ground_side if n in listed and n.endswith(ends))
    model, x, covariance = as_calibrated(loop, estimate.without(absent), unknown)
    part = model.at_poses(np.flatnonzero(later))
    return JointLoops(
        experiment=both,
        later=later,
        model=model,
        x=with_estimated_place(part, x, new.poses.q_rad, unknown),
        covariance=covariance,
        unknown=unknown,
    )


def as_calibrated(
    loop: ClosureModel, estimate: Estimate, unknown: Collection[str] = ()
) -> tuple[ClosureModel, FloatArray, FloatArray]:
    """Return a loop with the parameters of `estimate` and those named `unknown`, their values, and their covariance.

    All other parameters are fixed at their nominal values. Raises `ValueError` if `estimate` has a parameter that the
    arm in this fixture does not have.
    """
    known = estimate.values_by_name
    # Lengths and twists that the calibration corrected within tolerances are parameters too.
    model = freed(loop, known)
    model = model.without({p.name for p in model.parameters} - {*known, *unknown})
    names = [p.name for p in model.parameters]
    if strange := sorted(set(known) - set(names)):
        raise ValueError(f"{strange[0]} is not a parameter of this arm in this fixture")
    covariance = np.diag(np.where(np.isin(names, list(unknown)), NOT_KNOWN**2, 0.0))
    columns = [names.index(name) for name in known]
    covariance[np.ix_(columns, columns)] = estimate.covariance
    return model, nominal_vector(model.parameters, known), covariance


def predict_new_poses(
    loops: JointLoops, solution: Solution
) -> tuple[WhitenedResiduals, Chi2Test, Mapping[str, FloatArray]] | None:
    """Predict new poses from the poses of the calibration.

    Returns None if no model fits both sets of poses, or else:

    - whitened residuals of the new poses, in their order, with at least the stated variances;
    - the chi2 test of the new poses, with the variances estimated in the calibration;
    - derivatives (m, E, k) of each pose's E closure equations by each possible shift: by joint number or `FIXTURE`.
    """
    both, later, model, x0 = loops.experiment, loops.later, loops.model, loops.x
    errors = errors_as_calibrated(solution, model, both, without=loops.unknown)
    learned = {} if solution.components is None else solution.components.variances

    def at_least_stated(design: Layout) -> FloatArray:
        return np.maximum(design.stated_variances(), _as_learned(design, learned))

    try:
        fitted = fit_as_stated(
            model, both.poses, errors, x0,
            # The old poses have no information about a socket of new poses.
            old=len(later) if loops.unknown else int((~later).sum()),
            variances=at_least_stated,
        )  # fmt: skip
        design, equations = fitted.fit.design, fitted.fit.system
        fit = LinearFit(design, equations, at_least_stated(design))
        sharp = LinearFit(design, equations, _as_learned(design, learned))
    except (PosesDoNotFitError, np.linalg.LinAlgError):
        return None
    known = None
    if solution.estimate.estimator == "paper":
        # The paper's estimate is not an optimum of these equations: it is tested at its own values.
        at = equations.state.x if isinstance(equations, Linearisation) else fitted.x
        flat = design.flat_index
        known = (x0 - at)[flat], loops.covariance[np.ix_(flat, flat)]
    residuals = predicted_residuals(fit, later, known)
    if not np.isfinite(residuals.chi2):
        return None
    system = fit.whole.at_poses(np.flatnonzero(later))
    used = [j for j in range(1, both.arm.joint_count + 1) if j not in model.unsensed_joints]
    subjects = {str(j): system.B[..., [j - 1]] for j in used}
    ground = [
        k
        for k, p in enumerate(model.parameters)
        if p.name in model.ground_side and p.name not in loops.unknown
    ]
    if ground:
        subjects[FIXTURE] = system.A[..., ground]
    dof = max(residuals.dof - len(loops.unknown), 1)
    chi2 = chi2_test(predicted_residuals(sharp, later, known).chi2, dof)
    return replace(residuals, dof=dof), chi2, subjects


def errors_as_calibrated(
    solution: Solution,
    model: ClosureModel,
    experiment: Experiment,
    poses: IntArray | slice = slice(None),
    *,
    without: Collection[str] = (),
) -> ErrorModel:
    """Return the stated errors of `poses`, with the tolerances and priors that a calibration used.

    `model`: loops of the poses with the calibration's parameters. `without`: parameters that get no prior.
    """
    tolerated = {p.name for p in model.parameters} & set(solution.tolerated)
    sought = model.without(tuple(tolerated))
    arm = experiment.arm.with_length_tolerance(solution.length_tolerance_m)
    stated = free_within_tolerance(sought, arm, fixed=solution.held)[1]
    by_paper = solution.estimate.estimator == "paper"
    prior = {} if by_paper else stated_priors(sought, arm, experiment.fixture)
    return error_model(
        experiment,
        poses,
        tolerance={name: sd for name, sd in stated.items() if name in tolerated},
        prior={name: sd for name, sd in prior.items() if name not in without},
    )


def _as_learned(design: Layout, learned: Mapping[str, float]) -> FloatArray:
    """Return variances (K,) of the error components for a prediction, from the calibration's estimates (`learned`).

    Estimates from one part of the workspace may be too small in another: every result is at least a fixed share of the
    stated variance (method, section 10). A variance of noise never exceeds the stated one.
    """
    v = design.stated_variances()
    for k, c in enumerate(design.components):
        variance = learned.get(c.name)
        if variance is None or not c.scaled:
            continue
        if k in design.noise_components:
            v[k] = min(max(variance, STATED_VARIANCE_SHARE * v[k]), v[k])
        else:
            v[k] = max(variance, variance + STATED_VARIANCE_SHARE * (v[k] - variance))
    return v


def fit_as_stated(
    model: ClosureModel,
    both: PoseSet,
    errors: ErrorModel,
    x0: FloatArray,
    *,
    old: int,
    variances: Callable[[Layout], FloatArray] = Layout.stated_variances,
) -> MixedFit:
    """Fit old and new poses together, at the stated variances or those that `variances` returns.

    The fit first assumes that the arm sags in the direction of gravity. If the first `old` poses contradict this, the
    fit is repeated with both directions of sag equally likely.
    """
    design = LinearModel(model, both.q_rad, errors, group=both.placement)
    v = variances(design)
    fitted = fit_mixed(design, x0, variances=v)
    if (
        fitted.fit.design.expected.any()
        and gravity_share(fitted.fit.at_poses(np.arange(old))) < 0.5
    ):
        # By the calibration's own poses the arm does not sag in the direction of gravity.
        fitted = fit_mixed(design.unsigned(), fitted.x, variances=v)
    return fitted


def _used(solution: Solution, poses: PoseSet) -> PoseSet:
    """Return the distinct poses that the calibration used; if there are more than `MOST`, an even selection of them."""
    on_branch = np.ones(len(poses), dtype=np.bool_)
    on_branch[list(solution.dropped_flipped)] = False
    distinct = distinct_poses(poses, on_branch)[0]
    if len(distinct) > MOST:
        order = canonical_order(poses.q_rad[distinct])
        distinct = np.sort(distinct[order[evenly(len(order), MOST)]])
    return poses.at_poses(distinct)


def concatenated_poses(old: PoseSet, new: PoseSet) -> PoseSet:
    """Return both pose sets as one, the old poses first; kinds of data that only one set has are left out."""
    ends = [p.endpoint for p in (old, new) if p.endpoint is not None]
    columns = min((e.shape[1] for e in ends), default=0)
    spreads = [p.sd_rad for p in (old, new) if p.sd_rad is not None]
    return PoseSet(
        placement=np.concatenate((old.placement, new.placement)),
        label=tuple(str(k) for k in range(len(old) + len(new))),
        q_rad=np.concatenate((old.q_rad, new.q_rad)),
        sd_rad=np.concatenate(spreads) if len(spreads) == 2 else None,
        samples=np.concatenate((old.sample_counts, new.sample_counts)),
        endpoint=np.concatenate([e[:, :columns] for e in ends]) if len(ends) == 2 else None,
        utc=None if old.utc is None or new.utc is None else old.utc + new.utc,
    )

"""The iteration that fits parameters, effects, joint corrections and variances together.

Each iteration solves the mixed-model equations for parameters, effects and corrections, changes the variances by one
scoring step, and linearises the loops again at the new angles. A change too small for nonlinearity to matter needs no
new linearisation. `solver.estimators.implicit` derives the same iteration without effects and variances.
"""

from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray, evenly
from solver.closing import close_loops
from solver.errors import PosesDoNotFitError
from solver.estimators.effects import Linearisation, LinearModel, State, System
from solver.estimators.error_model import ErrorModel
from solver.estimators.layout import Layout
from solver.estimators.least_squares import Progress
from solver.estimators.linear_fit import LinearFit
from solver.estimators.scoring import (
    Derivatives,
    ScoringStep,
    VarianceSearch,
    scale_spread,
    step,
    with_priors,
)
from solver.loops.closure import ClosureModel, unsensed_at_readings

MIXED_ITERATIONS = 40
SETTLED_SIGMA, SETTLED_BESIDE_VARIANCES_SIGMA = 1e-3, 2e-3
"""Largest error of a parameter, in standard errors, that the last iteration may leave. The second value applies if
variances, which are far less certain, are estimated too."""

STEADY_VARIANCE_SIGMA, CREEPING_VARIANCE_SIGMA = 1e-1, 2e-2
"""The iteration may end if no step of a variance exceeds this, in standard errors. CREEPING_VARIANCE_SIGMA applies if
the variances converge slowly, so that one step is a small part of the remaining distance."""

RELINEARISE_SIGMA = 1e-4
"""The next iteration reuses the linearisation if the last step left an error of at most this many sigmas."""

LEAST_GAIN = 0.3
"""The iteration ends once the slope of the log-likelihood along the next step is expected to be below this. The slope
is about twice the gain in log-likelihood that is still possible."""

COMPARABLE_SIGMA = 3.0
"""Largest change of a parameter, in standard errors, between iterations whose slopes are compared."""

SIGN_TEST_SIGMA, SIGN_TEST_VARIANCE_SIGMA, DOUBTFUL_SIGN_SHARE = 0.1, 1.5, 0.25
"""The sign of sag is tested when the fit has converged. An earlier test requires that the remaining error of
the parameters is below SIGN_TEST_SIGMA, and the last step of the variances below SIGN_TEST_VARIANCE_SIGMA (in sigmas).
It counts if `gravity_share` differs from 0.5 by at least DOUBTFUL_SIGN_SHARE, or by at least this last step."""

FREE_ITERATIONS = 20
NEGLIGIBLE_GAIN = 0.1
"""From iteration FREE_ITERATIONS on, the variances stay constant once the slope of a step is below NEGLIGIBLE_GAIN."""

CHI2_LARGE_START = 4.0
"""If chi2/dof exceeds this, the search for the variances starts at large values."""

CHI2_ABANDONED = 30.0
"""If chi2/dof exceeds this even at large variances, the variances are not estimated: so large a misfit is due to a
fault, which the tests diagnose."""

CURVATURE_SHARE = 3.0
"""The error of a Newton step, divided by the step, is taken as this times the step's largest component (rad, m)."""

LEAST_MOTION_SHARE, WEAK_MOTION_SHARE, MOST_TURN_RAD, TINY = 1e-3, 0.01, 0.02, 1e-200
"""Limits for directions in which joints hardly move a loop's end, e.g. if a measured position is beyond the reach of a
stretched arm. The loop is left open there if the motion is below LEAST_MOTION_SHARE of the total, or below
WEAK_MOTION_SHARE if joints would have to turn by more than about MOST_TURN_RAD. TINY avoids a division by zero."""

POSES_FOR_VARIANCES = 600
"""Number of poses that estimate the variances if there are more than twice as many; all poses would improve the
estimates by only a few per cent."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixedFit:
    """Result of `fit_mixed`, with the poses in the order of its `design`.

    `x`: parameters (P,). `corrections`, `unsensed`: joint corrections e (m, n) and unsensed angles (m, U), rad.
    `fit`: the linear fit at the solution.
    `final_derivatives`: derivatives of likelihood and priors at the poses used to estimate the variances; None if no
    variances were estimated.
    """

    x: FloatArray
    corrections: FloatArray
    unsensed: FloatArray
    fit: LinearFit
    final_derivatives: Derivatives | None
    iterations: int
    converged: bool

    def derivatives(self) -> Derivatives:
        """Return the derivatives of likelihood and priors (see `with_priors`) at the solution."""
        return with_priors(self.fit) if self.final_derivatives is None else self.final_derivatives


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitStart:
    """Result of an earlier fit of the same poses, from which a new fit may start.

    `corrections` (m, n): joint corrections, rad. `unsensed` (m, U): the angles that are unsensed in the new fit, rad.
    `layout`: layout of the earlier fit, with its poses in the order of the new fit.
    """

    corrections: FloatArray
    unsensed: FloatArray
    layout: Layout


def fit_mixed(
    design: LinearModel,
    x0: FloatArray,
    *,
    variances: FloatArray | None = None,
    near: FitStart | None = None,
    progress: Progress | None = None,
) -> MixedFit:
    """Fit parameters, effects, joint corrections and variances to the readings of `design`, from `x0` (P,).

    The fit also decides whether sag has the expected sign (`design.errors.signed`). If `variances` (K,) are given, it
    changes neither them nor the sign. `near`: an earlier fit to start from, allowed only together with `variances`.
    """
    if variances is not None or len(design.q) <= 2 * POSES_FOR_VARIANCES:
        return _iterate(design, x0, variances, progress, near)
    # Evenly over the poses in canonical order, so that the selection does not depend on their order.
    subset = evenly(len(design.q), POSES_FOR_VARIANCES)
    first = _iterate(design.at_poses(subset), x0, None, progress)
    if first.fit.design.errors.signed != design.errors.signed:
        design = design.unsigned()
    fitted = _iterate(design, first.x, first.fit.v, progress, derivatives=first.final_derivatives)
    return replace(
        fitted,
        iterations=first.iterations + fitted.iterations,
        converged=first.converged and fitted.converged,
    )


def _iterate(
    design: LinearModel,
    x0: FloatArray,
    variances: FloatArray | None,
    progress: Progress | None,
    near: FitStart | None = None,
    *,
    derivatives: Derivatives | None = None,
) -> MixedFit:
    """Return the fit of `design`, iterated from `x0` (P,) until it converges, or at most `MIXED_ITERATIONS` times.

    `variances` (K,): fixed variances; None to estimate them. `near`: see `fit_mixed`.
    `derivatives`: the `final_derivatives` of the result if the variances are fixed.
    """
    v = design.start_variances() if variances is None else variances
    free = variances is None and len(v) > 0
    settled = SETTLED_BESIDE_VARIANCES_SIGMA if free else SETTLED_SIGMA
    state = _start(design, x0, v, near)
    sign_asked = free and bool(design.expected.any())
    converged, iterations = False, 0
    ascent, newton_step = VarianceSearch(), ScoringStep.none(len(v))
    linearisation, remaining = Linearisation(design, state), 0.0
    for iterations in range(1, MIXED_ITERATIONS + 1):
        if remaining > RELINEARISE_SIGMA:
            linearisation = Linearisation(design, state)
        fit = LinearFit(design, linearisation, v)
        if iterations == 1 and free and fit.chi2 > CHI2_LARGE_START * fit.dof:
            # The stated errors do not explain these readings: start with large deflections.
            v = np.maximum(v, design.raise_limits)
            fixed_fit = _iterate(design, x0, v, progress)
            if not fixed_fit.fit.chi2 <= CHI2_ABANDONED * fixed_fit.fit.dof:
                return fixed_fit
            fit = LinearFit(design, linearisation, v)
        state, largest_step, remaining = _advance(design, linearisation, fit)
        if not np.isfinite(largest_step):
            raise PosesDoNotFitError
        if progress is not None:
            progress(iterations, fit.chi2)
        if free:
            derivatives = with_priors(fit)
            newton_step = step(fit, derivatives)
            v = ascent.next_variances(
                fit, derivatives, newton_step, far=largest_step > COMPARABLE_SIGMA
            )
            if iterations >= FREE_ITERATIONS and newton_step.slope < NEGLIGIBLE_GAIN:
                # The variances are fixed from here on; the parameters converge with the present ones.
                free, newton_step, v = False, ScoringStep.none(len(v)), fit.v
        steady_limit = STEADY_VARIANCE_SIGMA if ascent.fast else CREEPING_VARIANCE_SIGMA
        converged = remaining < settled and (
            newton_step.largest < steady_limit or ascent.slope_left < LEAST_GAIN
        )
        nearly = remaining < SIGN_TEST_SIGMA and newton_step.largest < SIGN_TEST_VARIANCE_SIGMA
        if sign_asked and (nearly or converged or iterations >= FREE_ITERATIONS):
            surplus = gravity_share(fit) - 0.5
            in_doubt = abs(surplus) < min(DOUBTFUL_SIGN_SHARE, newton_step.largest)
            sign_asked = in_doubt and not converged and iterations < FREE_ITERATIONS
            if surplus < 0.0 and not sign_asked:
                # The expected sag is dropped from here on; likelihoods and steps before and after cannot be compared.
                design, converged = design.unsigned(), False
                ascent = VarianceSearch(fast=ascent.fast)
                linearisation = Linearisation(design, state)
                continue
        if converged:
            break
    if variances is None and derivatives is not None:
        mean = expected_variances(fit, derivatives, v)
        if not np.array_equal(mean, fit.v):
            # Once more, linearised at the solution, with the means of the estimated scales.
            linearisation = Linearisation(design, state)
            fit = LinearFit(design, linearisation, mean)
            state, _, _ = _advance(design, linearisation, fit)
    return MixedFit(
        x=state.x, corrections=state.e, unsensed=state.u, fit=fit, final_derivatives=derivatives,
        iterations=iterations, converged=converged,
    )  # fmt: skip


def expected_variances(fit: LinearFit, derivatives: Derivatives, v: FloatArray) -> FloatArray:
    """Return `v` (K,) with posterior means instead of modes for the variances that have a log-normal prior.

    A mode does not include the uncertainty of the variance. If an error is exp(t) times the stated one, with
    t ~ N(t_mode, s^2), its mean square is exp(2 t_mode + 2 s^2) times the stated variance.
    """
    return np.asarray(
        np.minimum(v * np.exp(2.0 * scale_spread(fit, derivatives)), fit.design.ceilings)
    )


def gravity_share(fit: LinearFit) -> float:
    """Return the factor that, applied to the sag and play expected from gravity, gives the best fit to the readings.

    If the factor is below one half, the readings fit better without expected sag and play (0) than with them (1).
    """
    design = fit.design
    G = np.concatenate(
        [fit.system.at_poses(s).B @ design.expected[s, :, None] for s in design.parts()]
    )
    s, C = fit.score(G)
    return float(1.0 - s[0] / max(C[0, 0], 1e-300))


def _start(design: LinearModel, x0: FloatArray, v: FloatArray, near: FitStart | None) -> State:
    """Return the state at parameters `x0` (P,) from which the iteration starts.

    Joint corrections and unsensed angles are those of `near`. If it is None, corrections are 0, and the unsensed angles
    are those that close the loops best, with the noise at variances `v` (K,).
    """
    x, q = np.array(x0, dtype=float), design.q
    if near is not None:
        e, u = near.corrections, near.unsensed
        return State(x=x, e=e, u=u, closed_q=q + e, closed_u=u)
    if design.model.unsensed_joints:
        sd = np.sqrt(design.noise_variance(v).mean(axis=0)[: q.shape[1]])
        u = close_loops(design.model, x, q, sigma_rad=sd, max_iterations=3).u
    else:
        # The fixture's own angles follow from the readings.
        u = unsensed_at_readings(design.model, x, q)
    return State(x=x, e=np.zeros_like(q), u=u, closed_q=q, closed_u=u)


def _advance(design: LinearModel, at: Linearisation, fit: LinearFit) -> tuple[State, float, float]:
    """Return the next state, the largest change of a parameter, and the error that remains after this change.

    The change and the error are in standard errors of the parameter. If the step is not finite, both are nan and the
    state is the old one.
    """
    old = at.state
    x = np.where(design.has_prior, design.nominal, old.x) + fit.change
    dx = x - old.x
    e, deflection = design.effects_at(fit.b, old.closed_q)
    u, closed_q, closed_u = old.closed_u.copy(), design.q.copy(), old.closed_u.copy()
    for part in fit.parts():
        poses, system = part.poses, at.at_poses(part.poses)
        multipliers = np.swapaxes(part.L_inverse, -1, -2) @ fit.residual(part)[..., None]
        noise = part.noise * (np.swapaxes(system.noise_columns, -1, -2) @ multipliers)[..., 0]
        e[poses] -= noise[:, : e.shape[1]]
        deflection[poses] -= noise[:, e.shape[1] :]
        turned = e[poses] + _closing(system, deflection[poses])
        closed_q[poses] += turned
        rates = at.rates(poses)
        u[poses] += rates.unsensed_step(dx, e[poses], deflection[poses])
        closed_u[poses] += rates.unsensed_step(dx, turned, np.zeros_like(deflection[poses]))
    changes = (dx, closed_q - old.closed_q, closed_u - old.closed_u)
    largest = max(float(np.abs(d).max(initial=0.0)) for d in changes)
    if not np.isfinite(largest):
        return old, float("nan"), float("nan")
    sd = np.maximum(fit.standard_deviation, 1e-150)
    largest_step = float(np.abs(dx / sd).max(initial=0.0))
    # Far from closure a full step can wrap an angle, so no step exceeds 1 rad or 1 m.
    shrink = min(1.0, 1.0 / max(largest, 1e-300))
    new = State(
        x=old.x + shrink * dx,
        e=old.e + shrink * (e - old.e),
        u=old.u + shrink * (u - old.u),
        closed_q=old.closed_q + shrink * (closed_q - old.closed_q),
        closed_u=old.closed_u + shrink * (closed_u - old.closed_u),
    )
    return new, largest_step, largest_step * (1.0 - shrink + min(1.0, CURVATURE_SHARE * largest))


def _closing(system: System, deflection: FloatArray) -> FloatArray:
    """Return the smallest joint rotations (m, n) with the same effect on the closure as `deflection` (m, k)."""
    open_by = np.swapaxes(system.E, -1, -2) @ deflection[..., None]
    Bt = np.swapaxes(system.B, -1, -2)
    square = system.B @ Bt
    # Directions in which joints hardly move a pose stay open, so that no joint turns far.
    size = np.trace(square, axis1=-2, axis2=-1)
    far = (open_by**2).sum((-2, -1)) / (2.0 * MOST_TURN_RAD) ** 2
    ridge = np.clip(far, LEAST_MOTION_SHARE**2 * size, WEAK_MOTION_SHARE**2 * size) + TINY
    square += ridge[:, None, None] * np.eye(square.shape[-1])
    return np.asarray((Bt @ np.linalg.solve(square, open_by))[..., 0])


def expected_fit(
    model: ClosureModel,
    q: FloatArray,
    errors: ErrorModel,
    x: FloatArray,
    *,
    group: IntArray | None = None,
) -> LinearFit:
    """Return the linear fit to be expected of a calibration with parameters `x` (P,) and stated `errors`.

    Its poses are those nearest to `q` (m, n), rad, at which the loops close. There are no readings, so the covariance
    of the returned fit is meaningful, but its chi2 is not. `group`: placement of each pose (m,).
    """
    sd = np.sqrt(np.maximum(errors.joint_variance.mean(axis=0), 1e-12))
    closed = close_loops(model, x, q, sigma_rad=sd)
    poses_q = np.where(closed.closed[:, None], closed.q, q)
    design = LinearModel(model, poses_q, errors, group=group)
    at = State(
        x=np.array(x, dtype=float), e=np.zeros_like(poses_q), u=closed.u,
        closed_q=poses_q, closed_u=closed.u,
    )  # fmt: skip
    return LinearFit(design, Linearisation(design, at), design.stated_variances())

"""The implicit estimator with every stated source of error: it fits parameters, effects and variances together.

The specification of an encoder is reliable; the stated noise of an RVDT and the stated compliance of a fixture are not,
and a maker's lengths are known only within a tolerance. All errors form one linear mixed model
(`solver.estimators.effects`), iterated by `solver.estimators.mixed_fit`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from solver.arrays import FloatArray, IntArray, evenly, select_poses
from solver.chain.parameters import nominal_vector, wrap_angle
from solver.chain.poses import back_to_caller, canonical_order
from solver.chain.sensors import rms_per_amplitude
from solver.estimators.effects import LinearModel
from solver.estimators.error_model import ErrorModel
from solver.estimators.estimate import Estimate, closure_at_readings, require_enough_poses
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.layout import FIXTURE_NOISE, Layout
from solver.estimators.least_squares import Progress
from solver.estimators.linear_fit import LinearFit
from solver.estimators.mixed_fit import FitStart, MixedFit, fit_mixed
from solver.estimators.scoring import Derivatives
from solver.loops.closure import ClosureModel, in_order, nearest_equivalent

EQUAL = 1e-9
"""Parameter vectors count as equal if no element differs by more than this (rad, m)."""

COMPLIANCE_LEVEL = 0.01
"""p-value below which the fixture counts as more compliant than stated."""

NORMAL_95 = 1.959963984540054
"""Standard normal deviate of a two-sided 95 % interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """Standard deviation `sd` of one source of error, with its 95 % interval, and the value `stated` in the files.

    `name`: ``fixture_m`` or ``fixture_rad`` for the fixture's deflection, ``rvdt_6`` for the noise of a single reading
    of joint 6, ``curve_6`` for the linearity deviation of its sensor. `unit`: ``rad`` or ``m``.
    """

    name: str
    unit: str
    sd: float
    low: float
    high: float
    stated: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceTest:
    """Score test whether a fixture is more compliant than stated: whether its rotations or translations scatter more.

    `statistic`: square of the larger of the two scores, each divided by its standard deviation; 0 if both are negative.
    `p_value`: probability of a statistic at least as large if the stated compliance is right.
    `deflects`: whether `p_value` is below `COMPLIANCE_LEVEL`, i.e. the fixture is more compliant than stated.
    """

    statistic: float
    p_value: float
    deflects: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class VarianceComponents:
    """Results of a fit in addition to the parameters.

    `components`: standard deviations, with intervals, of the errors of RVDTs and of the fixture's deflection.
    `variances`: every estimated variance by component name.
    `compliance`: test whether the fixture is more compliant than stated; None if not tested.
    `noise`: estimated variances of each pose's readings and of the fixture's deflection. The variance of a reading does
    not include errors that repeat from pose to pose.
    `repeatability`: covariance (P, P) of the parameters from noise alone: their scatter if all poses were repeated.
    `budget`: contribution (P,) of each source to the parameters' variances; the sum over all sources is the total.
    `signed`: whether joints are taken to sag in the direction of gravity; False if the readings contradict this.
    """

    components: tuple[Component, ...]
    compliance: ComplianceTest | None = field(metadata={"record": "flexure"})
    noise: NoiseModel
    repeatability: FloatArray
    budget: dict[str, FloatArray]
    variances: Mapping[str, float] = field(default_factory=dict)
    signed: bool = True

    def at_poses(self, poses: IntArray) -> VarianceComponents:
        """Return a copy in which `noise` covers only the readings of a selection of poses."""
        return replace(self, noise=select_poses(self.noise, poses, "joint_variance"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibrated:
    """An estimate, its variance components, and the linear fit that further tests use.

    `linear`: the fit, with its poses in canonical order. `order` (m,): the caller's index of each pose of `linear`.
    `derivatives`: derivatives of likelihood and priors with respect to the variances, at the solution.
    `unsensed`: unsensed angles (m, U), rad, in the caller's order.
    """

    estimate: Estimate
    components: VarianceComponents
    linear: LinearFit
    derivatives: Derivatives
    order: IntArray
    unsensed: FloatArray

    def few(self, most: int) -> tuple[Calibrated, IntArray]:
        """Return the calibration for at most `most` poses, chosen evenly, and the caller's indices of these poses.

        Parameters and their covariance still come from all poses; the linear fit covers only the chosen poses.
        """
        if len(self.order) <= most:
            return self, np.arange(len(self.order))
        # Evenly in canonical order, so that the selection does not depend on the poses' order.
        subset = evenly(len(self.order), most)
        of_caller = np.sort(self.order[subset])
        reduced = replace(
            self,
            estimate=self.estimate.at_poses(of_caller),
            components=self.components.at_poses(of_caller),
            linear=self.linear.at_poses(subset),
            order=np.searchsorted(of_caller, self.order[subset]),
            unsensed=self.unsensed[of_caller],
        )
        return reduced, of_caller


def estimate_with_errors(
    model: ClosureModel,
    q: FloatArray,
    errors: ErrorModel,
    *,
    x0: FloatArray | None = None,
    group: IntArray | None = None,
    progress: Progress | None = None,
) -> Calibrated:
    """Fit parameters, joint corrections, effects and variances to joint angles `q` (m, n), rad, from `x0` (P,).

    `x0` is by default the estimate without effects (`solver.estimators.implicit`), with parameters of
    `errors.tolerance` at nominal values. `group`: placement of each pose (m,). Raises `ValueError` if `errors` name a
    joint whose reading is not used, or a parameter that is not free; `TooFewPosesError` without degrees of freedom.
    """
    fitted, order = settle(model, q, errors, x0=x0, group=group, progress=progress)
    back = back_to_caller(order)
    return Calibrated(
        estimate=estimate_of(fitted, order),
        components=_report(fitted, back),
        linear=fitted.fit,
        derivatives=fitted.derivatives(),
        order=order,
        unsensed=fitted.unsensed[back],
    )


def estimate_of(fitted: MixedFit, order: IntArray) -> Estimate:
    """Return a fit's estimate in the caller's order of poses; `order` (m,): the caller's index of each fitted pose."""
    fit, design = fitted.fit, fitted.fit.design
    error = closure_at_readings(design.model, fitted.x, design.q)
    return Estimate(
        estimator="implicit",
        parameters=design.model.parameters,
        x=fitted.x,
        covariance=fit.covariance,
        residual=error.residual,
        rotation_rows=error.rotation_rows,
        flipped=error.flipped_poses,
        dof=require_enough_poses(design.model, len(design.q), known=len(design.errors.tolerance)),
        chi2=fit.chi2,
        pose_chi2=np.concatenate([(fit.residual(part) ** 2).sum(-1) for part in fit.parts()]),
        corrections=fitted.corrections,
        iterations=fitted.iterations,
        converged=fitted.converged,
    ).at_poses(back_to_caller(order))


def settle(
    model: ClosureModel,
    q: FloatArray,
    errors: ErrorModel,
    *,
    x0: FloatArray | None = None,
    group: IntArray | None = None,
    near: FitStart | None = None,
    variances: Callable[[Layout], FloatArray] | None = None,
    progress: Progress | None = None,
) -> tuple[MixedFit, IntArray]:
    """Fit like `estimate_with_errors`, but return the fit itself, and the order (m,) of its poses.

    The fit sorts the poses (`canonical_order`); pose k of the fit is the caller's pose ``order[k]``. If several
    parameter vectors are equivalent, the fit has the one nearest to the nominal values. `near`: see `fit_mixed`.
    `variances`: function that returns fixed variances (K,) for a layout; None to estimate them.
    """
    order = canonical_order(q)
    model, q, errors = model.at_poses(order), q[order], errors.at_poses(order)
    group = None if group is None else group[order]
    if near is not None:
        near = select_poses(near, order, "corrections", "unsensed")
    require_enough_poses(model, len(q), known=len(errors.tolerance))
    nominal = nominal_vector(model.parameters)
    if x0 is None:
        x0 = _first(model, q, errors, progress)
    x0 = _near(model, errors, x0, nominal)
    like = None if near is None else near.layout
    design = LinearModel(model, q, errors, group=group, like=like)
    v = None if variances is None else variances(design)
    fitted = fit_mixed(design, x0, near=near, variances=v, progress=progress)
    x = _near(model, errors, nearest_equivalent(model, fitted.x, nominal), nominal)
    if np.abs(x - fitted.x).max() > EQUAL:
        # An equivalent parameter vector has another covariance: continue from that vector.
        fitted = fit_mixed(fitted.fit.design, x, variances=v)
    return fitted, order


def _near(
    model: ClosureModel, errors: ErrorModel, x: FloatArray, nominal: FloatArray
) -> FloatArray:
    """Return `x` with full turns added to each angle that has a prior, so that it is within half a turn of nominal."""
    priors = {*errors.tolerance, *errors.prior}
    known = [p.is_angle and p.name in priors for p in model.parameters]
    return np.where(known, nominal + wrap_angle(x - nominal), x)


def _first(
    model: ClosureModel, q: FloatArray, errors: ErrorModel, progress: Progress | None
) -> FloatArray:
    """Return the default start (P,): an estimate without effects, with the parameters of `errors.tolerance` nominal."""
    variance = errors.joint_variance.copy()
    for a in errors.analogue:
        variance[:, a.joint - 1] += a.variance * a.share
    endpoint = errors.endpoint_variance if errors.endpoint_variance.any() else None
    noise = NoiseModel(joint_variance=variance, fixture_variance=endpoint)
    exact = model.without(tuple(errors.tolerance))
    return in_order(model, exact, estimate_implicit(exact, q, noise, progress=progress).x)


def noise_left(fitted: MixedFit, back: IntArray) -> NoiseModel:
    """Return the noise that a fit has estimated, with the poses in the caller's order (see `VarianceComponents.noise`).

    `back` (m,): index in the fit of each of the caller's poses.
    """
    design, v = fitted.fit.design, fitted.fit.v
    joints, fixture = np.split(design.noise_variance(v), [design.model.joint_count], axis=1)
    deflection_variance = np.zeros(6)
    deflection_variance[6 - design.rows :] = fixture.mean(axis=0)
    deflection_variance += design.smooth_deflection_variance(v)
    return NoiseModel(joint_variance=joints[back], fixture_variance=deflection_variance)


def _report(fitted: MixedFit, back: IntArray) -> VarianceComponents:
    fit = fitted.fit
    design = fit.design
    error = standard_errors(fitted.derivatives().information, fit.v, design.floors)
    return VarianceComponents(
        components=components(design, fit.v, error),
        compliance=compliance_test(fit.stated, design),
        noise=noise_left(fitted, back),
        repeatability=fit.repeatability,
        budget=fit.budget(),
        variances={c.name: float(v) for c, v in zip(design.components, fit.v, strict=True)},
        signed=design.errors.signed,
    )


LEAST_LEFT = 1e-12
"""If less than this share of a variance's information remains when the others are estimated, its error is infinite."""

MOST_CERTAIN = 1e6
"""Largest ratio of a variance to its standard error that `interval` uses."""


def components(design: LinearModel, v: FloatArray, error: FloatArray) -> tuple[Component, ...]:
    """Report noise and linearity of RVDTs, and fixture noise; `v`, `error` (K,): variances and standard errors."""
    out = []
    for k, c in enumerate(design.components):
        kind = c.name.split("_")[0]
        if kind not in ("rvdt", "curve", "fixture"):
            continue
        to_sd = rms_per_amplitude() if kind == "curve" else 1.0
        variances = (v[k], *interval(float(v[k]), float(error[k])), c.stated)
        sd, low, high, stated = (np.sqrt(variances) * to_sd).tolist()
        unit = "m" if c.name.endswith("_m") else "rad"
        out.append(Component(name=c.name, unit=unit, sd=sd, low=low, high=high, stated=stated))
    return tuple(out)


def compliance_test(stated: LinearFit, design: LinearModel) -> ComplianceTest | None:
    """Test whether the fixture's noise is larger than stated; None if no compliance of the fixture is stated."""
    from scipy.special import ndtr

    slots = [design.index[name] for name in FIXTURE_NOISE if name in design.index]
    if not slots:
        return None
    derivatives = stated.derivatives
    z = derivatives.score[slots] / np.sqrt(np.diagonal(derivatives.information)[slots])
    statistic = float(np.maximum(z, 0.0).max() ** 2)
    p_value = min(1.0, len(slots) * float(ndtr(-np.sqrt(statistic))))
    return ComplianceTest(statistic=statistic, p_value=p_value, deflects=p_value < COMPLIANCE_LEVEL)


def standard_errors(information: FloatArray, v: FloatArray, floor: FloatArray) -> FloatArray:
    """Return the standard errors (K,) of variances `v` (K,), from the likelihood's `information` (K, K).

    A variance at its floor counts as known in the errors of the others; its own error includes their uncertainty.
    """
    inner = v > floor * (1.0 + 1e-9)
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = information / np.outer(size, size)
    inverse = np.linalg.pinv(scaled[np.ix_(inner, inner)], rcond=1e-12)
    across = scaled[np.ix_(~inner, inner)]
    own = np.empty(len(v))
    own[inner] = np.diagonal(inverse)
    # Remaining information of each outer component, given the inner ones (Schur).
    unexplained = 1.0 - ((across @ inverse) * across).sum(-1)
    own[~inner] = np.where(unexplained > LEAST_LEFT, 1.0 / np.maximum(unexplained, LEAST_LEFT), 0.0)
    # A variance whose information is only rounding has an infinite error.
    return np.where(own > 0.0, np.sqrt(np.maximum(own, 0.0)), np.inf) / size


def interval(variance: float, error: float) -> tuple[float, float]:
    """Return the 95 % interval of a variance with standard error `error`, by Satterthwaite's approximation.

    The estimate v, with standard error s, is taken as chi2-distributed with 2 v^2 / s^2 degrees of freedom. This is
    exact if v is the only variance of the model.
    """
    from scipy.special import chdtri

    degrees = 2.0 * min(variance / max(error, 1e-300), MOST_CERTAIN) ** 2
    if degrees < 1.0:
        # The variance is nearly zero: the lower end is zero, and chi2's upper end would tend to infinity.
        return 0.0, variance + NORMAL_95 * error
    # chdtri takes the probability above.
    low, high = chdtri(degrees, (0.025, 0.975))
    return float(degrees * variance / low), float(degrees * variance / high)

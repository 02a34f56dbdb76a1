"""How noisy each RVDT is and how much the fixture gives, estimated together with the parameters.

The specification of an encoder can be believed; an RVDT's noise and a fixture's flexure cannot.
They separate, because an RVDT's error acts along its own joint's column only. On the reduced linear
system of the implicit estimator

    V_i = B_i S B_i' + sum_j v_j b_ij b_ij' + E_i' (v_rad I_rot + v_m I_pos) E_i

the variances v maximise the restricted likelihood (`solver.estimators.reml`), alternating with the implicit
iteration. The flexure stays zero unless a likelihood-ratio test asks for it. Two errors that are no
noise may be planned as well, since no number of poses averages them out: the curve of a sensor, and
lengths known to a tolerance. Knows no fixture, no screen and no file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.parameters import nominal_vector
from solver.chain.pose_order import back_to_caller, canonical_order
from solver.chain.sensor_curve import rms_per_amplitude
from solver.estimators.component_model import ComponentModel, ComponentPlan
from solver.estimators.component_report import Component, FlexureTest, components, flexure_test
from solver.estimators.estimate import Estimate
from solver.estimators.goodness import closure_at_readings, closure_sigmas
from solver.estimators.implicit import ImplicitFit, NoiseModel, estimate_implicit, fit_implicit
from solver.estimators.least_squares import Progress
from solver.estimators.reml import MixedModel, RemlFit, fit_reml
from solver.loops.closure import ClosureModel

ALTERNATIONS = 40
SETTLED = 1e-5
"""Change of every variance and parameter, in standard errors, that ends the alternation."""

NULL_ITERATIONS = 25
"""A rigid fixture that is anywhere near plausible is fitted in far fewer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VarianceComponents:
    """What was found beside the parameters.

    Attributes
    ----------
    components
        Every component with its interval; the fixture's only when it was found to give.
    flexure
        The test of the fixture; None where it was not asked for.
    noise
        The noise model that the estimate used, rows in the order of the poses.
    curves_rad
        Predicted deviation (m,) of each planned curve at each pose's reading, by joint.
    iterations, converged
        Alternations between the implicit iteration and the likelihood.
    """

    components: tuple[Component, ...]
    flexure: FlexureTest | None
    noise: NoiseModel
    curves_rad: dict[int, FloatArray]
    iterations: int
    converged: bool

    def sd(self, name: str) -> float:
        """Standard deviation of a component, 0 where it was not found (rad or m)."""
        return next((c.sd for c in self.components if c.name == name), 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _State:
    """Where the alternation is: parameters and variances that belong together."""

    fit: ImplicitFit
    mixed: MixedModel
    reml: RemlFit
    shift: FloatArray
    iterations: int
    converged: bool


def estimate_implicit_with_components(
    model: ClosureModel,
    q: FloatArray,
    noise: NoiseModel,
    plan: ComponentPlan,
    *,
    x0: FloatArray | None = None,
    progress: Progress | None = None,
) -> tuple[Estimate, VarianceComponents]:
    """Fit parameters, joint corrections and variances to joint angles `q` (m, n), rad.

    Parameters
    ----------
    noise
        Stated noise; for the planned joints it is a first value only.

    Returns
    -------
    The estimate, whose covariance holds for the variances found, and the variances. `chi2` counts
    the planned curves and tolerances as random; `pose_chi2` is what is left of each pose with them
    taken out.

    Raises
    ------
    ValueError
        If the plan names a joint without a used reading or a parameter that is not free.
    TooFewPosesError
        No degree of freedom would be left.
    """
    order = canonical_order(q)
    stated = np.broadcast_to(noise.joint_variance, q.shape)[order]
    problem = ComponentModel(
        model=model.at_poses(order),
        q=q[order],
        noise=NoiseModel(joint_variance=stated, fixture_variance=noise.fixture_variance),
        plan=plan,
    )
    x, iterations, test = _first(problem, x0, progress), 0, None
    chosen = None
    if plan.flexure:
        # A rigid model of a fixture that gives can be too far off to be fitted at all: the test is
        # made where the giving one has converged.
        chosen = _alternate(problem, x, flexure=True, progress=progress)
        x, iterations = chosen.fit.x, chosen.iterations
        start = np.where(problem.of_fixture, 0.0, chosen.reml.variances)
        rigid = fit_reml(
            chosen.mixed,
            start,
            held=problem.held | problem.of_fixture,
            max_iterations=NULL_ITERATIONS,
        )
        test = flexure_test(rigid.solution, chosen.reml.solution, problem.of_fixture)
    if chosen is None or (test is not None and not test.gives):
        chosen = _alternate(problem, x, flexure=False, progress=progress)
        iterations += chosen.iterations
    back = back_to_caller(order)
    return _estimate(problem, chosen, back), _report(problem, chosen, test, iterations, back)


def _first(problem: ComponentModel, x0: FloatArray | None, progress: Progress | None) -> FloatArray:
    """Parameters (P,) to start from, those with a tolerance at their nominal values."""
    x = nominal_vector(problem.model.parameters)
    hard = ~problem.soft
    exact = problem.model.without(tuple(problem.plan.tolerance))
    first = estimate_implicit(
        exact,
        problem.q,
        problem.noise,
        x0=None if x0 is None else x0[hard],
        progress=progress,
    )
    x[hard] = first.x
    return x


def _alternate(
    problem: ComponentModel, x: FloatArray, *, flexure: bool, progress: Progress | None
) -> _State:
    held = problem.held if flexure else problem.held | problem.of_fixture
    variances = problem.first_variances(flexure=flexure)
    shift = np.zeros_like(problem.q)
    curves = tuple(np.zeros(b.shape[-1]) for b in problem.curve_basis(problem.q))
    settled = False
    for iteration in range(1, ALTERNATIONS + 1):
        basis = problem.curve_basis(problem.q - shift)
        fit = fit_implicit(
            problem.model,
            problem.q - shift,
            problem.noise_at(variances),
            x,
            prior=problem.prior(),
            progress=progress,
        )
        mixed = problem.mixed(fit, basis, curves)
        reml = fit_reml(mixed, variances, held=held)
        error = np.sqrt(np.maximum(np.diagonal(reml.solution.information), 0.0))
        moved = float((np.abs(reml.variances - variances) * error).max(initial=0.0))
        sd = np.sqrt(np.diagonal(problem.parameter_covariance(reml.solution.covariance)))
        moved = max(moved, float((np.abs(fit.x - x) / sd).max(initial=0.0)))
        x, variances = fit.x, reml.variances
        settled = iteration > 1 and moved < SETTLED
        if settled or iteration == ALTERNATIONS:
            break
        curves = reml.solution.effects[: len(basis)]
        shift = np.zeros_like(problem.q)
        for curve, shapes, b in zip(problem.plan.curves, basis, curves, strict=True):
            shift[:, curve.joint - 1] = shapes @ b
    return _State(
        fit=fit,
        mixed=mixed,
        reml=reml,
        shift=shift,
        iterations=iteration,
        converged=settled and fit.converged and reml.converged,
    )


def _estimate(problem: ComponentModel, state: _State, back: IntArray) -> Estimate:
    fit, solution = state.fit, state.reml.solution
    error = closure_at_readings(problem.model, fit.x, problem.q)
    return Estimate(
        estimator="implicit",
        parameters=problem.model.parameters,
        x=fit.x,
        covariance=problem.parameter_covariance(solution.covariance),
        residual=error.residual[back],
        rotation_rows=error.rotation_rows,
        sigmas=closure_sigmas(error.residual, error.rotation_rows),
        flipped=tuple(int(i) for i in np.flatnonzero(error.flipped[back])),
        dof=fit.dof,
        chi2=solution.chi2,
        pose_chi2=fit.pose_chi2[back],
        corrections=(fit.corrections - state.shift)[back],
        iterations=fit.iterations,
        converged=state.converged,
    )


def _report(
    problem: ComponentModel,
    state: _State,
    test: FlexureTest | None,
    iterations: int,
    back: IntArray,
) -> VarianceComponents:
    labels = problem.labels
    floors = problem.floor_variance().mean(axis=0)
    floor, to_sd = np.zeros(len(labels)), np.ones(len(labels))
    for k, name in enumerate(labels):
        if name.startswith("rvdt_"):
            floor[k] = floors[int(name.removeprefix("rvdt_")) - 1]
        elif name.startswith("curve_"):
            to_sd[k] = rms_per_amplitude()
    silent = problem.held | (problem.of_fixture if test is None or not test.gives else False)
    noise = problem.noise_at(state.reml.variances)
    return VarianceComponents(
        components=components(state.reml, labels, held=silent, floor=floor, to_sd=to_sd),
        flexure=test,
        noise=NoiseModel(
            joint_variance=noise.joint_variance[back], fixture_variance=noise.fixture_variance
        ),
        curves_rad={c.joint: state.shift[back, c.joint - 1] for c in problem.plan.curves},
        iterations=iterations,
        converged=state.converged,
    )

"""The implicit estimator: the noise is in the joint readings and the fixture's deflection, and every loop closes.

The unknowns are the parameters x *and* each pose's joint corrections e (implicit loop method of Wampler,
Hollerbach & Arai 1995; the Gauss-Helmert model of geodesy). With f the fixture's deflection, the loop error c is
linearised at corrected joint angles q + e and current unsensed angles u,

    c + J_q (e_new - e) + J_u du + J_x dx + f = 0,      e ~ N(0, S), f ~ N(0, S_f).

The equations are multiplied by E', the left null space of J_u, and the stacked system

    minimise sum |w + A dx|^2 in the metric (B S B' + F)^-1,
    A = E' J_x,  B = E' J_q,  F = E' S_f E,  w = E' (c - J_q e)

is solved with scaled columns. Lagrange multipliers then give e_new, u and the next linearisation. The weights must be
evaluated at the corrected joints; weights evaluated at the measured joints would define a different estimator.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, pose_slices
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.chain.poses import back_to_caller, canonical_order
from solver.closing import Rates, ReducedEquations, close_loops, reduced_equations
from solver.errors import PosesDoNotFitError
from solver.estimators.estimate import Estimate, closure_at_readings, require_enough_poses
from solver.estimators.least_squares import Progress, triangle_of
from solver.estimators.paper import SAME_DESCRIPTION, estimate_paper
from solver.loops.closure import (
    ClosureModel,
    LoopError,
    in_order,
    nearest_equivalent,
    pose_blocks,
    unsensed_at_readings,
)

STEP_TOLERANCE = 1e-12
MAX_ITERATIONS = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseModel:
    """Variances of the joint readings and of the fixture's deflection.

    `joint_variance`: variance of each joint reading, (n,) or (m, n), rad^2.
    `fixture_variance`: variance of the deflection along the closure components, (6,), rad^2 then m^2; None for a rigid
    fixture. The model of a ball, whose closure has no rotations, uses the last three elements.
    """

    joint_variance: FloatArray
    fixture_variance: FloatArray | None = None

    @property
    def deflection_variance(self) -> FloatArray:
        """`fixture_variance` (6,), or zeros if it is None."""
        return np.zeros(6) if self.fixture_variance is None else self.fixture_variance


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterPrior:
    """Prior knowledge of parameters, e.g. lengths from the maker's table with a tolerance.

    `mean` (P,), rad and m; `precision` (P,): reciprocal of the prior variance, 0 if nothing is known.
    """

    mean: FloatArray
    precision: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ImplicitFit:
    """Result of the implicit estimator's iteration.

    `x` (P,), `covariance` (P, P): parameters, and their covariance under the noise model.
    `pose_chi2` (m,): each pose's share of chi2.
    `corrections` (m, n): joint corrections e, rad, adjusted minus measured. `unsensed` (m, U): unsensed angles, rad.
    """

    x: FloatArray
    covariance: FloatArray
    corrections: FloatArray
    unsensed: FloatArray
    pose_chi2: FloatArray
    dof: int
    iterations: int
    converged: bool

    @property
    def chi2(self) -> float:
        """Weighted sum of squared corrections."""
        return float(self.pose_chi2.sum())


def fit_implicit(
    model: ClosureModel,
    q: FloatArray,
    noise: NoiseModel,
    x0: FloatArray,
    *,
    prior: ParameterPrior | None = None,
    max_iterations: int = MAX_ITERATIONS,
    progress: Progress | None = None,
) -> ImplicitFit:
    """Fit parameters and joint corrections to measured joint angles `q` (m, n), rad, from `x0` (P,).

    Each parameter with a `prior` adds one unknown and one equation, so it does not reduce the degrees of freedom. The
    deviation of parameters from the prior's mean is not part of `pose_chi2`.
    """
    known = 0 if prior is None else int(np.count_nonzero(prior.precision))
    dof = require_enough_poses(model, len(q), known=known)
    variance = np.broadcast_to(noise.joint_variance, q.shape)
    x = np.array(x0, dtype=np.float64)
    u, e = unsensed_at_readings(model, x, q), np.zeros_like(q)
    if model.unsensed_joints:
        # Readings are poor initial angles: take them from loops closed as well as `x0` allows.
        sigma = np.sqrt(variance.mean(axis=0))
        u = close_loops(model, x, q, sigma_rad=sigma, u=u, max_iterations=3).u
    models = [part for part, _ in pose_blocks(model, q)]
    parts = list(zip(models, pose_slices(len(q)), strict=True))
    blocks: list[_Block] = []

    def linearised() -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield all equations, a block at a time, so that only one block's Jacobians are in memory."""
        blocks.clear()
        for part, poses in parts:
            error = part.loop(x, q[poses] + e[poses], u[poses])
            blocks.append(_Block.of(error, e[poses], variance[poses], noise))
            yield blocks[-1].w, blocks[-1].A
        if prior is not None:
            root = np.sqrt(prior.precision)
            yield root * (x - prior.mean), np.diag(root)

    iterations, converged = 0, False
    for iterations in range(1, max_iterations + 1):
        triangle = triangle_of(linearised())
        step, _ = triangle.step()
        after = zip(*(block.after(step) for block in blocks), strict=True)
        e_new, du, pose_chi2 = (np.concatenate(values) for values in after)
        largest = max(
            float(np.abs(step).max(initial=0.0)),
            float(np.abs(e_new - e).max(initial=0.0)),
            float(np.abs(du).max(initial=0.0)),
        )
        if not np.isfinite(largest):
            break
        # Far from closure a full step can wrap an angle, so no step exceeds 1 rad or 1 m.
        shrink = min(1.0, 1.0 / max(largest, 1e-300))
        x, e, u = x + shrink * step, e + shrink * (e_new - e), u + shrink * du
        if progress is not None:
            progress(iterations, float(pose_chi2.sum()))
        if largest < STEP_TOLERANCE:
            converged = True
            break
    return ImplicitFit(
        x=x,
        covariance=triangle.covariance(),
        corrections=e,
        unsensed=u,
        pose_chi2=pose_chi2,
        dof=dof,
        iterations=iterations,
        converged=converged,
    )


def estimate_implicit(
    model: ClosureModel,
    q: FloatArray,
    noise: NoiseModel,
    *,
    x0: FloatArray | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Fit `model` to joint angles `q` (m, n), rad, from `x0` (P,).

    By default, the start is the paper's estimate, or the nominal values if there are too few poses for it. Raises
    `TooFewPosesError` if no degree of freedom would be left.
    """
    order = canonical_order(q)
    model, q = model.at_poses(order), q[order]
    noise = replace(noise, joint_variance=np.broadcast_to(noise.joint_variance, q.shape)[order])
    nominal = nominal_vector(model.parameters)
    if x0 is None:
        require_enough_poses(model, len(q))
        x0, sensed = nominal, model.with_all_joints_sensed()
        if len(q) * sensed.equations_per_pose > len(sensed.parameters):
            x0 = in_order(model, sensed, estimate_paper(sensed, q, progress=progress).x)
    fit = fit_implicit(model, q, noise, x0, progress=progress)
    x = nearest_equivalent(model, fit.x, nominal)
    if np.abs(wrap_angles(model.parameters, x - fit.x)).max(initial=0.0) > SAME_DESCRIPTION:
        # An equivalent parameter vector has another covariance: continue from that vector.
        fit = fit_implicit(model, q, noise, x)
    else:
        fit = replace(fit, x=x)
    error = closure_at_readings(model, fit.x, q)
    return Estimate(
        estimator="implicit",
        parameters=model.parameters,
        x=fit.x,
        covariance=fit.covariance,
        residual=error.residual,
        rotation_rows=error.rotation_rows,
        flipped=error.flipped_poses,
        dof=fit.dof,
        chi2=fit.chi2,
        pose_chi2=fit.pose_chi2,
        corrections=fit.corrections,
        iterations=fit.iterations,
        converged=fit.converged,
    ).at_poses(back_to_caller(order))


def linearise(
    error: LoopError, e: FloatArray, variance: FloatArray, deflection_variance: FloatArray
) -> tuple[ReducedEquations, FloatArray]:
    """Return the loops' reduced equations, linearised at corrections `e` (m, n), and their covariances (m, r, r).

    `variance` (m, n): variance of each joint reading, the diagonals of S. `deflection_variance` (6,): variance of the
    fixture's deflection, the diagonal of S_f. The covariance is ``B S B' + F`` (see the module).
    """
    reduced = reduced_equations(error)
    E, B = reduced.E, reduced.B
    Bt, Et = np.swapaxes(B, -1, -2), np.swapaxes(E, -1, -2)
    V = B @ (variance[..., :, None] * Bt)
    if deflection_variance.any():
        V = V + Et @ (deflection_variance[..., -E.shape[-2] :, None] * E)
    return replace(reduced, w=reduced.w - (B @ e[..., None])[..., 0]), V


def whitener(V: FloatArray) -> FloatArray:
    """Return the matrices ``L^-1`` (..., r, r) that whiten misclosures of covariances ``V = L L'``.

    Raises `PosesDoNotFitError` if V has no such factor, because poses are far from closing.
    """
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(V)))
    except np.linalg.LinAlgError as error:
        raise PosesDoNotFitError from error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Block:
    """Linearised and whitened equations of some poses. w, A, B and E' (`Et`) are those of the module's docstring."""

    w: FloatArray
    A: FloatArray
    B: FloatArray
    Et: FloatArray
    rates: Rates
    joint_variance: FloatArray
    deflection_variance: FloatArray

    @classmethod
    def of(cls, error: LoopError, e: FloatArray, variance: FloatArray, noise: NoiseModel) -> _Block:
        """Return the whitened equations of loops with closure error `error`, linearised at corrections `e` (m, n).

        `variance` (m, n): variance of each joint reading. `noise`: gives the variance of the fixture's deflection.
        """
        deflection_variance = noise.deflection_variance
        system, V = linearise(error, e, variance, deflection_variance)
        whiten = whitener(V)
        return cls(
            w=(whiten @ system.w[..., None])[..., 0],
            A=whiten @ system.A,
            B=whiten @ system.B,
            Et=whiten @ np.swapaxes(system.E, -1, -2),
            rates=Rates.of(error, e),
            joint_variance=variance,
            deflection_variance=deflection_variance[-error.residual.shape[-1] :],
        )

    def after(self, step: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return corrections (m, n), changes of unsensed angles (m, U) and each pose's chi2 (m,) after a step (P,)."""
        residual = self.w + self.A @ step
        across = residual[..., None, :]
        e = -self.joint_variance * (across @ self.B)[..., 0, :]
        deflection = -self.deflection_variance * (across @ self.Et)[..., 0, :]
        return e, self.rates.unsensed_step(step, e, deflection), (residual * residual).sum(-1)

"""Closes loops at fixed parameters by the most probable corrections of the readings; finds angles of unsensed joints.

The iteration is that of the implicit estimator, but the parameters stay as they are.
"""

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.closing import ReducedEquations, close_loops, left_inverse, unsensed_step
from solver.diagnostics.statistics import covariance_root
from solver.estimators.implicit import NoiseModel, linearise
from solver.loops.closure import ClosureModel, LoopError

STEP_TOLERANCE = 1e-9
MAX_ITERATIONS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class AdjustedPoses:
    """Poses whose loops were closed at fixed parameters.

    `error`, `system`, `V`: closure errors, reduced equations, and covariances (m, r, r) of the misclosures. They belong
    to the state before the last step, which is negligibly small.
    `corrections` (m, n): adjusted minus measured joint angles, rad.
    `unsensed` (m, U): unsensed angles, rad; those of arm joints are last.
    `converged` (m,): whether each pose's loop was closed.
    """

    error: LoopError
    system: ReducedEquations
    V: FloatArray
    corrections: FloatArray
    unsensed: FloatArray
    converged: BoolArray


def adjust_poses(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    noise: NoiseModel,
    *,
    near: tuple[FloatArray, FloatArray] | None = None,
) -> AdjustedPoses:
    """Close the loops of poses `q` (m, n), rad, at parameters `x` (P,) by the most likely corrections of the readings.

    `near`: corrections (m, n) and unsensed angles (m, U), rad, from which to start, if known.
    """
    variance = np.broadcast_to(noise.joint_variance, q.shape)
    deflection_variance = noise.deflection_variance
    if near is None:
        sd = np.sqrt(variance.mean(axis=0))
        near = np.zeros_like(q), close_loops(model, x, q, sigma_rad=sd, max_iterations=3).u
    e, u = near
    step_size = open_by = np.full(len(q), np.inf)
    for _ in range(MAX_ITERATIONS):
        error = model.loop(x, q + e, u)
        system, V = linearise(error, e, variance, deflection_variance)
        multipliers = np.linalg.solve(V, system.w[..., None])
        e_new = -variance * (np.swapaxes(system.B, -1, -2) @ multipliers)[..., 0]
        slack = -deflection_variance[-error.residual.shape[-1] :] * (system.E @ multipliers)[..., 0]
        du = unsensed_step(error, (error.jac_q @ (e_new - e)[..., None])[..., 0] + slack)
        before = step_size
        step_size = np.concatenate((np.abs(e_new - e), np.abs(du)), axis=-1).max(-1, initial=0.0)
        # Steps shrink at least as fast as the last two did.
        open_by = (
            step_size * np.where(step_size < before, step_size / np.maximum(before, 1e-300), 1.0)
            if np.isfinite(before).all()
            else step_size
        )
        # Shortened steps let a pose that is far from closing approach without oscillating.
        shrink = np.minimum(1.0, 0.5 / np.maximum(step_size, 1e-300))[:, None]
        e, u = e + shrink * (e_new - e), u + shrink * du
        if bool(np.all(open_by < STEP_TOLERANCE)):
            break
    return AdjustedPoses(
        error=error, system=system, V=V,
        corrections=e, unsensed=u, converged=open_by < STEP_TOLERANCE,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopAngle:
    """Angle of one unsensed joint at each of m poses, with the covariance ``diag(own) + common common'``, rad^2.

    `angle_rad` (m,): joint angle theta' including the offset, not wrapped. The joint's own reading is used only to
    start the iteration.
    `own` (m,): variance of each angle due to the noise of its own pose, which is independent of the other poses.
    `common` (m, c): one column for each independent error of the parameters, which is the same in all poses.
    """

    angle_rad: FloatArray
    own: FloatArray
    common: FloatArray

    @property
    def variance(self) -> FloatArray:
        """Variance of each angle (m,)."""
        return np.asarray(self.own + (self.common**2).sum(-1))

    def variance_of(self, H: FloatArray) -> FloatArray:
        """Variance (k,) of linear combinations H (k, m) of the angles."""
        return np.asarray((H**2) @ self.own + ((H @ self.common) ** 2).sum(-1))


def loop_angles(
    model: ClosureModel,
    x: FloatArray,
    covariance: FloatArray,
    q: FloatArray,
    noise: NoiseModel,
    *,
    near: tuple[FloatArray, FloatArray],
) -> dict[int, LoopAngle]:
    """Estimate the angles of the unsensed arm joints (1-based) from readings `q` (m, n), rad.

    `covariance`: covariance (P, P) of `x`. `near`: joint corrections (m, n) and unsensed angles (m, U) to start from.

    The linearised loop is c + J_q e + f + N du = 0: c is the closure error, e the errors of the readings, f the
    fixture's deflection, du the change of the unsensed angles. With S the covariance of J_q e + f, and E the left null
    space of N, du has the covariance ``N^+ (S - S E (E' S E)^-1 E' S) N^+'``. The covariance due to `x` is added.
    """
    adjusted = adjust_poses(model, x, q, noise, near=near)
    error = adjusted.error
    variance = np.broadcast_to(noise.joint_variance, q.shape)
    S = (error.jac_q * variance[:, None, :]) @ np.swapaxes(error.jac_q, -1, -2)
    S = S + np.diag(noise.deflection_variance[-S.shape[-1] :])
    system = adjusted.system
    inverse = left_inverse(error.jac_u)
    SE = S @ system.E
    # The part of the noise known from the pose's other equations is removed.
    gain = np.swapaxes(np.linalg.solve(adjusted.V, np.swapaxes(SE, -1, -2)), -1, -2)
    S_left = S - gain @ np.swapaxes(SE, -1, -2)
    spread = inverse @ S_left @ np.swapaxes(inverse, -1, -2)
    rates = -inverse @ (error.jac_x - gain @ system.A)
    root = covariance_root(covariance)
    first = adjusted.unsensed.shape[-1] - len(model.unsensed_joints)
    return {
        joint: LoopAngle(
            angle_rad=adjusted.unsensed[:, k], own=spread[:, k, k], common=rates[:, k, :] @ root
        )
        for k, joint in enumerate(model.unsensed_joints, first)
    }

"""Angles of unsensed joints as the closed loop itself measures them, with their uncertainty.

Knows closure models and an estimate; no sensor and no verdict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.closing import left_inverse
from solver.diagnostics.pose_adjustment import adjust_poses
from solver.diagnostics.smooth_curve import Scatter
from solver.estimators.implicit import NoiseModel
from solver.loops.closure import ClosureModel


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopAngle:
    """True angle of one unsensed joint at every pose.

    Attributes
    ----------
    joint
        1-based.
    angle_rad
        theta' (m,), continuous, near the reading plus the nominal offset.
    pose_variance
        Variance from the pose's own readings (m,), rad^2: independent between poses.
    by_parameters
        (m, P): change of the angle with the parameters; common to all poses.
    """

    joint: int
    angle_rad: FloatArray
    pose_variance: FloatArray
    by_parameters: FloatArray

    def scatter(self, root: FloatArray) -> Scatter:
        """Covariance of the angles, rad^2, with ``root root'`` the covariance of the parameters."""
        return Scatter(own=self.pose_variance, common=self.by_parameters @ root)


def loop_angles(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    noise: NoiseModel,
    *,
    near: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[LoopAngle, ...]:
    """Measure the unsensed arm joints of `model` at parameters `x` (P,) and readings `q` (m, n).

    With c + J_q e + f + N du = 0 the best estimate of du has covariance
    ``N^+ (S - S E (E' S E)^-1 E' S) N^+'``, S the covariance of J_q e + f. `near` is that of
    `adjust_poses`.
    """
    adjusted = adjust_poses(model, x, q, noise, near=near)
    error = adjusted.error
    variance = np.broadcast_to(noise.joint_variance, q.shape)
    S = (error.jac_q * variance[:, None, :]) @ np.swapaxes(error.jac_q, -1, -2)
    if noise.fixture_variance is not None:
        S = S + np.diag(noise.fixture_variance[-S.shape[-1] :])
    system = adjusted.system
    inverse = left_inverse(error.jac_u)
    SE = S @ system.E
    # What the pose's other equations say of the noise is taken out of it.
    gain = np.swapaxes(np.linalg.solve(system.V, np.swapaxes(SE, -1, -2)), -1, -2)
    left = S - gain @ np.swapaxes(SE, -1, -2)
    spread = inverse @ left @ np.swapaxes(inverse, -1, -2)
    rates = -inverse @ (error.jac_x - gain @ system.A)
    first = adjusted.unsensed.shape[-1] - len(model.unsensed_joints)
    return tuple(
        LoopAngle(
            joint=joint,
            angle_rad=adjusted.unsensed[:, first + k],
            pose_variance=spread[:, first + k, first + k],
            by_parameters=rates[:, first + k, :],
        )
        for k, joint in enumerate(model.unsensed_joints)
    )

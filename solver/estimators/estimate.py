"""The result of every estimator, the closure error at the readings, and the check that there are enough poses.

sigma_pos and sigma_ori (paper, eqs. 14 and 15) are computed at the measured joint angles.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from solver.arrays import FloatArray, IntArray, join_poses, select_poses
from solver.chain.parameters import Parameter
from solver.closing import close_loops
from solver.errors import TooFewPosesError
from solver.loops.closure import (
    ClosureModel,
    ClosureSigmas,
    ReducedError,
    closure_sigmas,
    in_order,
    pose_blocks,
    poses_needed,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Identified parameters and how well they are known.

    `x` (P,): values of `parameters`, rad and m. Of several equivalent vectors, it is the one nearest to the nominal
    values. Angles are in (-pi, pi], but within half a turn of their nominal values if they have a prior.
    `covariance` (P, P): covariance of `x` if the estimator's noise model is right.
    `residual` (m, r): reduced closure error at the *measured* joint angles; of the r values of a pose, the first
    `rotation_rows` are rad, the others m.
    `flipped`: indices of poses on the other branch of the closure, where the tool is upside down on the hinge.
    `dof`: degrees of freedom: equations minus parameters.
    `chi2`, `pose_chi2`: weighted sum of squared residuals, and each pose's share of it (m,); None without a noise
    model.
    `corrections` (m, n): joint corrections, rad, adjusted minus measured; None without a noise model.
    """

    estimator: Literal["paper", "implicit"]
    parameters: tuple[Parameter, ...]
    x: FloatArray
    covariance: FloatArray
    residual: FloatArray
    rotation_rows: int
    flipped: tuple[int, ...]
    dof: int
    iterations: int
    converged: bool
    chi2: float | None = None
    pose_chi2: FloatArray | None = None
    corrections: FloatArray | None = None

    @property
    def sigmas(self) -> ClosureSigmas:
        """Standard deviations sigma_pos, m, and sigma_ori, rad, of the closure error `residual` (eqs. 14 and 15)."""
        return closure_sigmas(self.residual, self.rotation_rows)

    @property
    def standard_deviation(self) -> FloatArray:
        """Standard deviation (P,) of every parameter."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def values_by_name(self) -> dict[str, float]:
        """Value of every parameter, rad or m."""
        return {p.name: v for p, v in zip(self.parameters, self.x.tolist(), strict=True)}

    @property
    def sd_by_name(self) -> dict[str, float]:
        """Standard deviation of every parameter, rad or m."""
        sd = self.standard_deviation.tolist()
        return {p.name: s for p, s in zip(self.parameters, sd, strict=True)}

    @property
    def chi2_per_dof(self) -> float | None:
        """chi2 over degrees of freedom, near 1 when the noise model is right."""
        return None if self.chi2 is None else self.chi2 / self.dof

    def without(self, names: Collection[str]) -> Estimate:
        """Return the estimate without the parameters `names`; the covariance of the others does not change."""
        indices = [k for k, p in enumerate(self.parameters) if p.name not in names]
        if len(indices) == len(self.parameters):
            return self
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in indices),
            x=self.x[indices],
            covariance=self.covariance[np.ix_(indices, indices)],
        )

    def given(self, names: Collection[str]) -> Estimate:
        """Return the estimate without the parameters `names`, whose values are regarded as exact.

        The covariance of the other parameters is conditioned on these values.
        """
        indices = [k for k, p in enumerate(self.parameters) if p.name not in names]
        rest = self.without(names)
        if len(indices) == len(self.parameters):
            return rest
        known = [k for k in range(len(self.parameters)) if k not in indices]
        C = self.covariance
        across = C[np.ix_(indices, known)]
        explained = across @ np.linalg.pinv(C[np.ix_(known, known)], hermitian=True) @ across.T
        return replace(rest, covariance=rest.covariance - explained)

    def at_poses(self, poses: IntArray) -> Estimate:
        """Return the estimate with the per-pose results of selected poses only; a pose may be selected repeatedly."""
        return replace(
            select_poses(self, poses, "residual", "pose_chi2", "corrections"),
            flipped=tuple(np.flatnonzero(np.isin(poses, self.flipped)).tolist()),
        )

    def value(self, name: str) -> float:
        """Return the value of one parameter, rad or m."""
        return float(self.x[[p.name for p in self.parameters].index(name)])


def require_enough_poses(model: ClosureModel, poses: int, *, known: int = 0) -> int:
    """Return the degrees of freedom of a fit to `poses` poses. Raises `TooFewPosesError` if there are none.

    `known`: number of parameters with a prior; they are not counted, because each prior adds an equation.
    """
    count = len(model.parameters) - known
    dof = poses * model.equations_per_pose - count
    if dof <= 0:
        raise TooFewPosesError(
            poses=poses,
            needed=poses_needed(count, model.equations_per_pose),
            parameters=count,
            equations_per_pose=model.equations_per_pose,
        )
    return dof


def closure_at_readings(model: ClosureModel, x: FloatArray, q: FloatArray) -> ReducedError:
    """Return the closure error at the *measured* joint angles `q` (m, n), rad, without derivatives.

    Unsensed joints take the angles that close each loop best; their readings are not used.
    """
    errors = (_at_readings(part, x, part_q) for part, part_q in pose_blocks(model, q))
    return join_poses(errors, "residual", "jac_x", "flipped")


def _at_readings(model: ClosureModel, x: FloatArray, q: FloatArray) -> ReducedError:
    if not model.unsensed_joints:
        return model.reduced(x, q, rates=False)
    # Each placement may have its own offset of an unsensed joint.
    parts = model.parts()
    errors = [_at_unsensed_angles(part, x[columns], q[poses]) for part, columns, poses in parts]
    return model.with_all_joints_sensed().merged(errors)


def _at_unsensed_angles(model: ClosureModel, x: FloatArray, q: FloatArray) -> ReducedError:
    """Return the closure error of one placement, with unsensed joints at the angles that close each loop best."""
    u = close_loops(model, x, q, sigma_rad=np.zeros(q.shape[-1]), max_iterations=50).u
    sensed, filled = model.with_all_joints_sensed(), q.copy()
    every = in_order(sensed, model, x)
    offsets = {p.name: value for p, value in zip(sensed.parameters, every, strict=True)}
    for joint in model.unsensed_joints:
        filled[:, joint - 1] = model.angle_of(u, joint) - offsets[f"theta_off_{joint}"]
    return sensed.reduced(every, filled, rates=False)

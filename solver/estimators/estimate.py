"""What every estimator returns, and the checks that come before any of them. Knows no estimator."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.parameters import Parameter
from solver.errors import TooFewPosesError
from solver.estimators.goodness import ClosureSigmas
from solver.loops.closure import ClosureModel, poses_needed


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Identified parameters and how well they are known.

    Attributes
    ----------
    estimator
        ``paper`` or ``implicit``.
    parameters, x
        The unknowns and their values (P,), rad and m; angles in (-pi, pi], in the description
        nearest to the nominal one.
    covariance
        (P, P) of `x` under the estimator's own noise model.
    residual, rotation_rows
        Reduced closure error at the *measured* joints (m, r), rotations (rad) before positions (m).
    sigmas
        sigma_pos and sigma_ori of that residual.
    flipped
        Indices of poses found on the flipped branch of the hinge.
    dof
        Degrees of freedom: equations less parameters.
    chi2
        Weighted sum of squares; None where the estimator has no noise model.
    pose_chi2
        Each pose's share of `chi2` (m,); None where the estimator has no noise model.
    corrections
        Joint corrections (m, n), rad, adjusted minus measured; None likewise.
    iterations, converged
        How the iteration went.
    """

    estimator: Literal["paper", "implicit"]
    parameters: tuple[Parameter, ...]
    x: FloatArray
    covariance: FloatArray
    residual: FloatArray
    rotation_rows: int
    sigmas: ClosureSigmas
    flipped: tuple[int, ...]
    dof: int
    chi2: float | None
    pose_chi2: FloatArray | None
    corrections: FloatArray | None
    iterations: int
    converged: bool

    @property
    def standard_deviation(self) -> FloatArray:
        """Standard deviation of every parameter (P,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def chi2_per_dof(self) -> float | None:
        """chi2 over degrees of freedom, near 1 when the noise model is right."""
        return None if self.chi2 is None else self.chi2 / self.dof

    def without(self, names: Collection[str]) -> Estimate:
        """Return the same estimate with some parameters not listed."""
        kept = [k for k, p in enumerate(self.parameters) if p.name not in names]
        if len(kept) == len(self.parameters):
            return self
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in kept),
            x=self.x[kept],
            covariance=self.covariance[np.ix_(kept, kept)],
        )

    def given(self, names: Collection[str]) -> Estimate:
        """Return what would be known of the others if some parameters were known exactly."""
        left = [k for k, p in enumerate(self.parameters) if p.name not in names]
        rest = self.without(names)
        if len(left) == len(self.parameters):
            return rest
        known = [k for k in range(len(self.parameters)) if k not in left]
        C = self.covariance
        across = C[np.ix_(left, known)]
        explained = across @ np.linalg.pinv(C[np.ix_(known, known)], hermitian=True) @ across.T
        return replace(rest, covariance=rest.covariance - explained)

    def at_poses(self, poses: IntArray) -> Estimate:
        """Return the same with what belongs to single poses for these, each as often as it is named."""
        return replace(
            self,
            residual=self.residual[poses],
            flipped=tuple(int(k) for k in np.flatnonzero(np.isin(poses, self.flipped))),
            pose_chi2=None if self.pose_chi2 is None else self.pose_chi2[poses],
            corrections=None if self.corrections is None else self.corrections[poses],
        )

    def value(self, name: str) -> float:
        """Value of one parameter, rad or m."""
        return float(self.x[[p.name for p in self.parameters].index(name)])


def require_enough_poses(model: ClosureModel, poses: int, *, known: int = 0) -> int:
    """Degrees of freedom of `poses` poses; TooFewPosesError when none is left.

    `known` parameters are not counted: a prior brings one equation for each of them.
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

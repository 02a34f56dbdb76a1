"""Poses whose readings do not fit the loop that the others agree on, by name. Excludes none itself.

Knows the implicit estimator and nothing of who took the poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray
from solver.estimators.implicit import ImplicitFit, NoiseModel, fit_implicit
from solver.judging.pose_adjustment import adjust_poses
from solver.loops.closure import ClosureModel

OUTLIER_LEVEL = 0.01
"""Chance of naming any pose of a pose set in which all are sound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlier:
    """A pose whose readings do not fit.

    Attributes
    ----------
    pose
        Index, 0-based, in the order of the caller.
    chi2, dof
        Misfit of the pose against an estimate from the poses that are not named, and its degrees of
        freedom.
    probability
        Chance of so large a misfit anywhere in a sound pose set (Bonferroni).
    """

    pose: int
    chi2: float
    dof: int
    probability: float


def outlier_poses(
    model: ClosureModel,
    q: FloatArray,
    noise: NoiseModel,
    x: FloatArray,
    *,
    level: float = OUTLIER_LEVEL,
) -> tuple[Outlier, ...]:
    """Name the poses (m, n) that do not fit, worst first; `x` (P,) is where estimates start.

    Each pose's misclosure is studentised by its own covariance *after* adjustment,
    ``V_i - A_i C A_i'``: a pose that pulls hard on the parameters hides less. The worst is taken out
    and the rest estimated anew while one is improbable. Poses wronged by the company they were in
    are then taken back: those that the final estimate predicts within its uncertainty.
    """
    problem = _Poses(model=model, q=q, noise=noise)
    m, r, P = len(q), model.equations_per_pose, len(model.parameters)
    kept = np.ones(m, dtype=np.bool_)
    fit = problem.fit(kept, x)
    while (int(kept.sum()) - 1) * r > P:
        pose, chance = _worst(fit, np.flatnonzero(kept))
        if chance * m >= level:
            break
        kept[pose] = False
        fit = problem.fit(kept, fit.x)
    while not kept.all():
        named = problem.judged(np.flatnonzero(~kept), fit)
        best = max(named, key=lambda outlier: outlier.probability)
        if best.probability < level:
            return tuple(sorted(named, key=lambda outlier: -outlier.chi2))
        kept[best.pose] = True
        fit = problem.fit(kept, fit.x)
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Poses:
    """All poses, from which parts are estimated and judged."""

    model: ClosureModel
    q: FloatArray
    noise: NoiseModel

    def noise_of(self, poses: IntArray) -> NoiseModel:
        variance = np.broadcast_to(self.noise.joint_variance, self.q.shape)
        return NoiseModel(
            joint_variance=variance[poses], fixture_variance=self.noise.fixture_variance
        )

    def fit(self, kept: BoolArray, x: FloatArray) -> ImplicitFit:
        poses = np.flatnonzero(kept)
        return fit_implicit(self.model.at_poses(poses), self.q[poses], self.noise_of(poses), x)

    def judged(self, poses: IntArray, fit: ImplicitFit) -> list[Outlier]:
        """Judge poses that took no part in `fit`."""
        from scipy.special import chdtrc

        adjusted = adjust_poses(
            self.model.at_poses(poses), fit.x, self.q[poses], self.noise_of(poses)
        )
        system = adjusted.system
        S = system.V + system.A @ fit.covariance @ np.swapaxes(system.A, -1, -2)
        chi2 = np.einsum("mr,mr->m", system.w, np.linalg.solve(S, system.w[..., None])[..., 0])
        # A pose that cannot be closed at all does not fit, whatever its linearised misfit says.
        chi2 = np.where(adjusted.converged, chi2, np.inf)
        dof = system.w.shape[-1]
        return [
            Outlier(
                pose=int(pose),
                chi2=float(value),
                dof=dof,
                probability=min(1.0, float(chdtrc(dof, value)) * len(self.q)),
            )
            for pose, value in zip(poses, chi2, strict=True)
        ]


def _worst(fit: ImplicitFit, poses: IntArray) -> tuple[int, float]:
    """Return the most improbable of the poses that took part, and its probability."""
    from scipy.special import chdtrc

    system = fit.system
    L = np.linalg.cholesky(system.V)
    A = np.linalg.solve(L, system.A)
    w = np.linalg.solve(L, system.w[..., None])[..., 0]
    left = np.eye(w.shape[-1]) - A @ fit.covariance @ np.swapaxes(A, -1, -2)
    values, vectors = np.linalg.eigh(0.5 * (left + np.swapaxes(left, -1, -2)))
    # In whitened coordinates an eigenvalue is the share of a component that the fit left free.
    free = values > 1e-6
    along = np.einsum("mrc,mr->mc", vectors, w)
    chi2 = np.where(free, along**2 / np.where(free, values, 1.0), 0.0).sum(-1)
    dof = np.maximum(free.sum(-1), 1)
    chance = np.asarray(chdtrc(dof, chi2))
    # Far out all probabilities are zero: the larger misfit per degree of freedom decides.
    worst = int(np.lexsort((-chi2 / dof, chance))[0])
    return int(poses[worst]), float(chance[worst])

"""What one pose would tell about the parameters, for thousands of candidate poses at once.

The same linearisation as the implicit estimator's, at closed poses: a pose adds ``A' V^-1 A`` to the
Fisher information (method, section 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.estimators.implicit import NoiseModel, linearise
from solver.loops.closure import ClosureModel

CURVE_SHARE = 0.5
"""Share of a sensor's linearity that is allowed for as if it were noise."""
UNSENSED_SIGMA_RAD = 1.0
"""Noise that stands for no sensor at all: a joint read this badly tells nothing about an offset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseInformation:
    """Square roots of the information of m poses about P parameters.

    Attributes
    ----------
    parameters
        Names, in column order.
    root
        (m, r, P): ``L^-1 A`` with ``V = L L'``; a pose's information is ``root' root``.
    """

    parameters: tuple[str, ...]
    root: FloatArray

    def of(self, poses: Sequence[int]) -> FloatArray:
        """Information of a set of poses (P, P); a pose listed twice counts twice."""
        rows = self.root[list(poses)].reshape(-1, len(self.parameters))
        return np.asarray(rows.T @ rows)

    def about(self, parameters: Sequence[str]) -> PoseInformation:
        """Keep the columns of `parameters`; the others count as known."""
        columns = [self.parameters.index(name) for name in parameters]
        return PoseInformation(parameters=tuple(parameters), root=self.root[..., columns])


def pose_information(
    model: ClosureModel, x: FloatArray, q: FloatArray, u: FloatArray, noise: NoiseModel
) -> PoseInformation:
    """Information of closed poses `q` (m, n), `u` (m, U) about the parameters `x` (P,) of `model`.

    The noise's fixture variance may be (6,) or one row a pose, (m, 6).

    Raises
    ------
    ValueError
        If a closure component has no noise at all (exact joints and a stiff fixture).
    """
    variance = np.broadcast_to(noise.joint_variance, q.shape)
    give = np.zeros(6) if noise.fixture_variance is None else np.asarray(noise.fixture_variance)
    system = linearise(model.loop(x, q, u), np.zeros_like(q), variance, give)
    try:
        L = np.linalg.cholesky(system.V)
    except np.linalg.LinAlgError as error:
        raise ValueError("joints without noise leave closure components without any") from error
    return PoseInformation(
        parameters=tuple(p.name for p in model.parameters), root=np.linalg.solve(L, system.A)
    )


def planning_noise(
    sigma_rad: FloatArray,
    *,
    unsensed_joints: Sequence[int] = (),
    wrist_curve_rad: FloatArray | None = None,
) -> NoiseModel:
    """Noise to plan with: one reading's standard deviations (n,), joints not to be relied upon apart.

    Parameters
    ----------
    unsensed_joints
        Joints (1-based) whose reading will not be used. They stay in the model, for their angle can
        be predicted, with a noise that tells nothing.
    wrist_curve_rad
        Systematic deviation of each sensor (n,) to be allowed for as if it were noise (an RVDT's
        linearity); None for none.
    """
    variance = np.asarray(sigma_rad, dtype=np.float64) ** 2
    if wrist_curve_rad is not None:
        variance = variance + wrist_curve_rad**2
    variance = variance.copy()
    variance[[j - 1 for j in unsensed_joints]] = UNSENSED_SIGMA_RAD**2
    return NoiseModel(joint_variance=variance)

"""Information of a pose about the parameters, for thousands of candidate poses at once.

The same linearisation as the estimators', at closed poses: a pose adds ``A' V^-1 A`` to the Fisher
information (method, section 3). Under stated errors the same rows have columns for the effects as well
(lengths, twists, encoders, play, sag, compliance), which a thousand similar poses determine no better than one (section
10).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray
from solver.estimators.effects import LinearModel
from solver.estimators.error_model import ErrorModel
from solver.estimators.implicit import NoiseModel, linearise
from solver.estimators.linearisation import Linearisation, State
from solver.loops.closure import ClosureModel

CURVE_SHARE = 0.5
"""Share of a sensor's linearity that is allowed for as if it were noise."""
UNSENSED_SIGMA_RAD = 1.0
"""Noise that stands for no sensor at all: readings this noisy have no information about an offset."""

EFFECTS = 40
"""Combinations of effects used in planning, those that poses determine best: on the packaged arms they carry 99.9 % of
the information, and a choice among 3,000 poses takes one second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseInformation:
    """Square roots of the information of m poses about P parameters and K effects.

    Attributes
    ----------
    parameters
        Names, in column order.
    root
        (m, r, P + K): ``L^-1 [A, Z]`` with ``V = L L'``; a pose's information is ``root' root``. The last K
        columns are effects, with a standard normal prior.
    misclosure
        (m, r): by how much the loops fail to close, in units of their noise.
    """

    parameters: tuple[str, ...]
    root: FloatArray
    misclosure: FloatArray

    def of(self, poses: Sequence[int]) -> FloatArray:
        """Information of a set of poses (P + K, P + K); a pose listed twice counts twice."""
        rows = self.root[list(poses)].reshape(-1, self.root.shape[-1])
        return np.asarray(rows.T @ rows)

    def about(self, parameters: Sequence[str]) -> PoseInformation:
        """Keep the columns of `parameters`, and of the effects; other parameters count as known."""
        columns = [self.parameters.index(name) for name in parameters]
        columns += range(len(self.parameters), self.root.shape[-1])
        return replace(self, parameters=tuple(parameters), root=self.root[..., columns])

    def at_poses(self, poses: slice) -> PoseInformation:
        """Return the information of a slice of the poses."""
        return replace(self, root=self.root[poses], misclosure=self.misclosure[poses])

    def with_errors_scaled(self, factor: float) -> PoseInformation:
        """Return the information if all errors, noise and effects, are `factor` times as large."""
        root = self.root.copy()
        root[..., : len(self.parameters)] /= factor
        return replace(self, root=root, misclosure=self.misclosure / factor)

    def error_scale(self) -> float:
        """How many times larger than stated the errors of these poses are; 1 where they are not larger."""
        P, w = len(self.parameters), self.misclosure.reshape(-1)
        dof = len(w) - P
        if dof <= 0:
            return 1.0
        rows = self.root.reshape(len(w), -1)
        # Effects enter as observations of zero, so that one least-squares problem covers all.
        prior = np.eye(rows.shape[-1])[P:]
        left = np.concatenate((w, np.zeros(len(prior))))
        columns = np.concatenate((rows, prior))
        left = left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
        return float(np.sqrt(max(1.0, float(left @ left) / dof)))


def about_parameters(information: FloatArray, parameters: int) -> FloatArray:
    """Information (P, P) about the first P of P + K unknowns, the others having a standard normal prior."""
    pp, pe = information[:parameters, :parameters], information[:parameters, parameters:]
    ee = information[parameters:, parameters:] + np.eye(len(information) - parameters)
    return np.asarray(pp - pe @ np.linalg.solve(ee, pe.T))


def information_under(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    closed_q: FloatArray,
    closed_u: FloatArray,
    errors: ErrorModel,
) -> PoseInformation:
    """Information about the parameters of `model` that have no tolerance, under stated errors.

    Parameters
    ----------
    x
        Parameters (P + T,) of `model`, toleranced ones among them.
    q
        Readings (m, n) of captured or planned poses.
    closed_q, closed_u
        Closed poses at `x` nearest to the readings: (m, n), (m, U).

    Raises
    ------
    ValueError
        If a closure component has no noise at all (exact joints and a stiff fixture).
    """
    design = LinearModel(model, q, errors)
    equations = Linearisation(
        design, State(x=x, e=closed_q - q, u=closed_u, closed_q=closed_q, closed_u=closed_u)
    )
    sizes = design.start_variances()
    root = np.sqrt(design.group_variances(sizes))
    try:
        parts = [design.whiten(equations.part(here), sizes, root, here) for here in design.parts()]
    except np.linalg.LinAlgError as error:
        raise ValueError(NOISELESS) from error
    columns, w = (np.concatenate(rows) for rows in zip(*((p.M, p.w) for p in parts), strict=True))
    effects = columns[..., design.hard :].reshape(-1, design.width - design.hard)
    # Leading combinations of independent effects are independent effects again.
    _, turn = np.linalg.eigh(effects.T @ effects)
    leading = (effects @ turn[:, : -EFFECTS - 1 : -1]).reshape(*w.shape, -1)
    return PoseInformation(
        parameters=tuple(model.parameters[k].name for k in design.hard_index),
        root=np.concatenate((columns[..., : design.hard], leading), axis=-1),
        misclosure=w,
    )


NOISELESS = "joints without noise leave closure components without any"


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
        raise ValueError(NOISELESS) from error
    return PoseInformation(
        parameters=tuple(p.name for p in model.parameters),
        root=np.linalg.solve(L, system.A),
        misclosure=np.linalg.solve(L, system.w[..., None])[..., 0],
    )


def planning_noise(
    sigma_rad: FloatArray,
    *,
    unsensed_joints: Sequence[int] = (),
    wrist_curve_rad: FloatArray | None = None,
) -> NoiseModel:
    """Noise to plan with: standard deviations of one reading (n,), larger for joints not to be relied upon.

    Parameters
    ----------
    unsensed_joints
        Joints (1-based) whose reading will not be used. They stay in the model, because their angle can be predicted,
        with noise so large that it carries no information.
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

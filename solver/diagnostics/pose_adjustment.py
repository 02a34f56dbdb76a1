"""Joint corrections of poses under parameters that are given and stay. Knows no estimator's unknowns.

The implicit iteration with dx = 0: what is left to adjust are the readings. It judges new poses by
a calibration made before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.closing import close_loops, unsensed_step
from solver.estimators.implicit import LinearisedPoses, NoiseModel, linearise
from solver.loops.closure import ClosureModel, LoopError

STEP_TOLERANCE = 1e-9
MAX_ITERATIONS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class AdjustedPoses:
    """Poses adjusted to fixed parameters.

    Attributes
    ----------
    error, system
        The loops of all poses and their reduced linear system, at the last step's start: it was so small
        that they hold at its end.
    corrections
        Joint corrections (m, n), rad: adjusted minus measured.
    unsensed
        Unsensed angles (m, U), rad.
    converged
        Whether each pose's loop was closed (m,).
    """

    error: LoopError
    system: LinearisedPoses
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
    """Find the most likely joint corrections of `q` (m, n), rad, that close the loops of `x` (P,).

    `near` are corrections (m, n) and unsensed angles (m, U), rad, to start from where any are known.
    """
    variance = np.broadcast_to(noise.joint_variance, q.shape)
    give = np.zeros(6) if noise.fixture_variance is None else noise.fixture_variance
    if near is None:
        sd = np.sqrt(variance.mean(axis=0))
        near = np.zeros_like(q), close_loops(model, x, q, sigma_rad=sd, max_iterations=3).u
    e, u = near
    moved = left = np.full(len(q), np.inf)
    for _ in range(MAX_ITERATIONS):
        error = model.loop(x, q + e, u)
        system = linearise(error, e, variance, give)
        multipliers = np.linalg.solve(system.V, system.w[..., None])
        e_new = -variance * (np.swapaxes(system.B, -1, -2) @ multipliers)[..., 0]
        slack = -give[-error.residual.shape[-1] :] * (system.E @ multipliers)[..., 0]
        du = unsensed_step(error, (error.jac_q @ (e_new - e)[..., None])[..., 0] + slack)
        before = moved
        moved = np.concatenate((np.abs(e_new - e), np.abs(du)), axis=-1).max(-1, initial=0.0)
        # The next step falls behind this one at least as this one fell behind the one before.
        left = (
            moved * np.where(moved < before, moved / before, 1.0)
            if np.isfinite(before).all()
            else moved
        )
        # A pose far from closing comes nearer by steps no joint would take back.
        shrink = np.minimum(1.0, 0.5 / np.maximum(moved, 1e-300))[:, None]
        e, u = e + shrink * (e_new - e), u + shrink * du
        if bool(np.all(left < STEP_TOLERANCE)):
            break
    return AdjustedPoses(
        error=error, system=system, corrections=e, unsensed=u, converged=left < STEP_TOLERANCE
    )

"""The paper's estimator: unweighted least squares on the reduced closure error (eqs. 5 and 6).

Every equation has the same weight: 1 m counts as 1 rad, and a 12-bit wrist reading as a 400,000-count encoder. It is
the published reference and the start of the implicit estimator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.chain.poses import canonical_order
from solver.estimators.estimate import (
    Estimate,
    closure_at_readings,
    closure_sigmas,
    require_enough_poses,
)
from solver.estimators.least_squares import Progress, Triangle, solve_damped, triangle_of
from solver.loops.closure import ClosureModel, nearest_equivalent, pose_blocks

SAME_DESCRIPTION = 1e-9
"""Parameters (rad, m) that differ by less, or by full turns, are equivalent."""


def estimate_paper(
    model: ClosureModel,
    q: FloatArray,
    *,
    x0: FloatArray | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Fit the parameters of `model` to measured joint angles `q` (m, n), rad.

    `x0`: start (P,); the nominal values by default. Raises `TooFewPosesError` if no degree of freedom would be left.
    """
    dof = require_enough_poses(model, len(q))
    nominal = nominal_vector(model.parameters)

    order = canonical_order(q)
    problem = ClosureProblem.of(model.at_poses(order), q[order])
    fit = solve_damped(problem, nominal if x0 is None else x0, progress=progress)
    x = nearest_equivalent(model, fit.x, nominal)
    # An equivalent parameter vector has another Jacobian, except after a full turn.
    turned = np.abs(wrap_angles(model.parameters, x - fit.x)).max(initial=0.0) > SAME_DESCRIPTION
    triangle = problem(x) if turned else fit.triangle
    error = closure_at_readings(model, x, q)
    return Estimate(
        estimator="paper",
        parameters=model.parameters,
        x=x,
        covariance=triangle.covariance() * (2.0 * fit.cost / dof),
        residual=error.residual,
        rotation_rows=error.rotation_rows,
        sigmas=closure_sigmas(error.residual, error.rotation_rows),
        flipped=tuple(int(i) for i in np.flatnonzero(error.flipped)),
        dof=dof,
        iterations=fit.iterations,
        converged=fit.converged,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureProblem:
    """The closure errors of all poses as a least-squares `Problem`, a block of poses at a time.

    `blocks`: loops of some poses and their joint angles (m_k, n), rad.
    """

    blocks: tuple[tuple[ClosureModel, FloatArray], ...]

    @classmethod
    def of(cls, model: ClosureModel, q: FloatArray) -> ClosureProblem:
        """Cut the poses `q` (m, n), rad, into blocks."""
        return cls(blocks=pose_blocks(model, q))

    def __call__(self, x: FloatArray) -> Triangle:
        """Closure error c and the paper's C = dc/dphi (eqs. 5, 6 and 13) at parameters `x` (P,)."""
        errors = (model.reduced(x, q) for model, q in self.blocks)
        return triangle_of((error.residual, error.jac_x) for error in errors)

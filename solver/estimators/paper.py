"""The paper's estimator: unweighted least squares on the reduced closure error (eqs. 5 and 6).

Every equation has the same weight: 1 m counts as 1 rad, and a 12-bit wrist reading counts as much as the reading of a
400,000-count encoder. The paper's estimate is the start value of the implicit estimator.
"""

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.chain.poses import canonical_order
from solver.estimators.estimate import Estimate, closure_at_readings, require_enough_poses
from solver.estimators.least_squares import Problem, Progress, Triangle, solve_damped, triangle_of
from solver.loops.closure import ClosureModel, nearest_equivalent, pose_blocks

SAME_DESCRIPTION = 1e-9
"""Parameters that differ by less than this (rad, m), or by full turns, are equivalent."""


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
    problem = closure_problem(model.at_poses(order), q[order])
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
        flipped=error.flipped_poses,
        dof=dof,
        iterations=fit.iterations,
        converged=fit.converged,
    )


def closure_problem(model: ClosureModel, q: FloatArray) -> Problem:
    """Return the least-squares problem of the poses `q` (m, n), rad, which is evaluated for a block of poses at a time.

    At parameters (P,), the residual is the closure error c, the Jacobian the paper's C = dc/dphi (eqs. 5, 6, 13).
    """
    blocks = pose_blocks(model, q)

    def problem(x: FloatArray) -> Triangle:
        errors = (part.reduced(x, part_q) for part, part_q in blocks)
        return triangle_of((error.residual, error.jac_x) for error in errors)

    return problem

"""The paper's estimator: unweighted least squares on the reduced closure error (eqs. 5 and 6).

Every equation counts the same, 1 m as 1 rad and a 12-bit wrist reading as a 400,000-count encoder.
It is kept as the published reference and as the start of the implicit estimator.
"""

from __future__ import annotations

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.chain.pose_order import back_to_caller, canonical_order
from solver.estimators.estimate import Estimate, require_enough_poses
from solver.estimators.goodness import closure_sigmas
from solver.estimators.least_squares import Progress, solve_damped
from solver.loops.closure import ClosureModel, nearest_equivalent


def estimate_paper(
    model: ClosureModel,
    q: FloatArray,
    *,
    x0: FloatArray | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Fit the parameters of `model` to measured joint angles `q` (m, n), rad.

    Parameters
    ----------
    x0
        Start (P,); the nominal values by default.

    Raises
    ------
    TooFewPosesError
        No degree of freedom would be left.
    """
    dof = require_enough_poses(model, len(q))
    nominal = nominal_vector(model.parameters)

    order = canonical_order(q)
    ordered, sorted_q = model.at_poses(order), q[order]

    def problem(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        error = ordered.reduced(x, sorted_q)
        return error.residual.reshape(-1), error.jac_x.reshape(-1, len(nominal))

    fit = solve_damped(problem, nominal if x0 is None else x0, progress=progress)
    x = nearest_equivalent(model, fit.x, nominal)
    error = ordered.reduced(x, sorted_q)
    back = back_to_caller(order)
    residual = error.residual[back]
    J = error.jac_x.reshape(-1, len(nominal))
    return Estimate(
        estimator="paper",
        parameters=model.parameters,
        x=x,
        covariance=np.asarray(np.linalg.pinv(J.T @ J, hermitian=True) * (2.0 * fit.cost / dof)),
        residual=residual,
        rotation_rows=error.rotation_rows,
        sigmas=closure_sigmas(error.residual, error.rotation_rows),
        flipped=tuple(int(i) for i in np.flatnonzero(error.flipped[back])),
        dof=dof,
        chi2=None,
        pose_chi2=None,
        corrections=None,
        iterations=fit.iterations,
        converged=fit.converged,
    )

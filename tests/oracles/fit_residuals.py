"""Whitened residuals of a linear system given as matrices, by one singular value decomposition."""

import numpy as np

from solver.arrays import FloatArray
from solver.diagnostics.whitened_residuals import WhitenedResiduals


def fit_residuals(
    w: FloatArray, A: FloatArray, V: FloatArray, *, prior_sd: FloatArray | None = None
) -> WhitenedResiduals:
    """Fit misclosures w (m, r) with Jacobian A (m, r, P) and covariance V (m, r, r).

    `prior_sd` (P,) is inf for parameters without a prior, the others are at their prior means.
    """
    m, r, P = A.shape
    whitener = np.linalg.inv(np.linalg.cholesky(V))
    X, y = (whitener @ A).reshape(m * r, P), (whitener @ w[..., None]).reshape(m * r)
    prior = np.zeros(P) if prior_sd is None else 1.0 / prior_sd
    U, s, Wt = np.linalg.svd(np.concatenate((X, np.diag(prior))), full_matrices=False)
    U = U[: m * r]
    residuals = y - U @ (U.T @ y)
    return WhitenedResiduals(
        whitener=whitener,
        U=U.reshape(m, r, P),
        white=residuals.reshape(m, r),
        chi2=float(y @ residuals),
        to_x=Wt.T / s,
        dof=m * r - int(np.count_nonzero(prior == 0.0)),
    )

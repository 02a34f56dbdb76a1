"""Whitened residuals of a linear system given as matrices, by one singular value decomposition."""

import numpy as np

from solver.arrays import FloatArray
from solver.diagnostics.whitened_residuals import WhitenedResiduals


def fit_residuals(
    w: FloatArray,
    A: FloatArray,
    V: FloatArray,
    *,
    drawn: FloatArray | None = None,
    prior_sd: FloatArray | None = None,
) -> WhitenedResiduals:
    """Fit misclosures w (m, r) with Jacobian A (m, r, P) and covariance V (m, r, r).

    `drawn` (m, r, c) are columns of random effects with a standard deviation of 1; `prior_sd` (P,) is inf for
    parameters without a prior, the others are at their prior means.
    """
    m, r, P = A.shape
    whitener = np.linalg.inv(np.linalg.cholesky(V))
    columns = A if drawn is None else np.concatenate((A, drawn), axis=-1)
    K = columns.shape[-1]
    white = whitener @ np.concatenate((columns, w[..., None]), axis=-1)
    X, y = white[..., :K].reshape(m * r, K), white[..., K].reshape(m * r)
    precision = np.ones(K)
    precision[:P] = 0.0 if prior_sd is None else 1.0 / prior_sd**2
    scale = np.sqrt(np.sum(X**2, axis=0) + precision)
    scale[scale == 0.0] = 1.0
    rows = np.concatenate((X, np.diag(np.sqrt(precision))[precision > 0.0]))
    Q, s, Wt = np.linalg.svd(rows / scale, full_matrices=False)
    observable = s > 1e-12 * s[0]
    U = Q[: m * r, observable]
    to_unknowns = (Wt[observable].T / s[observable]) / scale[:, None]
    components = U.T @ y
    residuals = y - U @ components
    return WhitenedResiduals(
        whitener=whitener,
        U=U.reshape(m, r, -1),
        white=residuals.reshape(m, r),
        chi2=float(y @ residuals),
        # w = -A dx: a coefficient is minus its parameter.
        to_x=to_unknowns[:P],
        dof=m * r - int(np.count_nonzero(precision == 0.0)),
    )

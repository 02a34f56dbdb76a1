"""What a linear fit left over, and what any further columns would explain of it. Knows no loop, no cause.

At the solution of a calibration the misclosures of all poses are

    w_i = -A_i dx + Z_i b + f_i,    f_i ~ N(0, V_i),    b ~ N(0, I),

with dx the parameters (those with a prior are among b) and V_i, Z_i at given sizes. In coordinates
whitened by V_i, P = I - U U' takes out everything that dx and b can explain. Then for columns G that
nobody fitted, G'Pw is the score, G'PG its covariance, and s'(G'PG)^-1 s how far chi2 would fall if
they were fitted (Rao 1948): no refit is needed to ask.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray

FREE = 1e-9
"""A direction of which the fit left less than this share is fitted already, not free."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOver:
    """A linear system of m poses with r equations each, P parameters and K fitted columns in all.

    Attributes
    ----------
    whitener
        (m, r, r): inverse of a root of V.
    U
        (m, r, K): whitened fitted columns, orthonormal together with their prior's rows.
    white
        (m, r): ``L^-1 w`` less what was fitted, P w.
    to_x
        (P, K): from coefficients of `U` to the parameters (rad, m).
    dof
        Equations less parameters that nothing was known of.
    """

    whitener: FloatArray
    U: FloatArray
    white: FloatArray
    chi2: float
    to_x: FloatArray
    dof: int

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters (P, P)."""
        return np.asarray(self.to_x @ self.to_x.T)

    def whiten(self, G: FloatArray) -> FloatArray:
        """Columns (m, r, c) in whitened coordinates."""
        return np.asarray(self.whitener @ G)

    def score(self, G: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Score (c,) of columns G (m, r, c) and its covariance (c, c)."""
        white = self.whiten(G).reshape(-1, G.shape[-1])
        inside = self.U.reshape(len(white), -1).T @ white
        return white.T @ self.white.reshape(-1), white.T @ white - inside.T @ inside

    def moved(self, G: FloatArray, b: FloatArray) -> FloatArray:
        """By how much the parameters (P,) would change if G (m, r, c) times b (c,) were taken out."""
        white = (self.whiten(G) @ b).reshape(-1)
        return np.asarray(self.to_x @ (self.U.reshape(len(white), -1).T @ white))

    def also(self, G: FloatArray) -> LeftOver:
        """Return what is left over when the columns G (m, r, c) are fitted as well."""
        m, r, K = self.U.shape
        white = self.whiten(G).reshape(m * r, -1)
        U = self.U.reshape(m * r, K)
        s, C = self.score(G)
        values, vectors = np.linalg.eigh(C)
        size = np.linalg.norm(white, axis=0).max(initial=1e-300) ** 2
        free = values > FREE * size
        root = vectors[:, free] / np.sqrt(values[free])
        inside = U.T @ white @ root
        # In the metric of the prior's rows the new columns are orthogonal to the old ones.
        new = white @ root - U @ inside
        along = root.T @ s
        return LeftOver(
            whitener=self.whitener,
            U=np.concatenate((U, new), axis=1).reshape(m, r, -1),
            white=self.white - (new @ along).reshape(m, r),
            chi2=self.chi2 - float(along @ along),
            to_x=np.concatenate((self.to_x, -self.to_x @ inside), axis=1),
            dof=self.dof - int(free.sum()),
        )

    def without(self, poses: IntArray) -> LeftOver:
        """Return what is left over when nothing is asked of some poses (p,): whitener and rows of theirs are zero.

        The same as to fit all of their equations with columns of their own, but nothing grows: the columns
        stay as many as they are, orthonormal over the rows that are left.
        """
        own = self.U[poses].reshape(-1, self.U.shape[-1])
        values, vectors = np.linalg.eigh(np.eye(len(own)) - own @ own.T)
        free = values > FREE
        root = vectors[:, free] / np.sqrt(values[free])
        along = root.T @ self.white[poses].reshape(-1)
        # Deleting rows R makes of U'U = I the matrix I - R'R; with `inside` its inverse is I + inside inside'.
        inside = own.T @ root
        square, turn = np.linalg.eigh(inside.T @ inside)
        turned = inside @ turn
        stretched = turned / (1.0 + np.sqrt(1.0 + np.maximum(square, 0.0)))
        whitener, U = self.whitener.copy(), self.U + (self.U @ stretched) @ turned.T
        white = self.white + self.U @ (inside @ along)
        whitener[poses], U[poses], white[poses] = 0.0, 0.0, 0.0
        return LeftOver(
            whitener=whitener,
            U=U,
            white=white,
            chi2=self.chi2 - float(along @ along),
            to_x=self.to_x + (self.to_x @ stretched) @ turned.T,
            dof=self.dof - int(free.sum()),
        )

    def also_drawn(self, G: FloatArray, sd: FloatArray) -> LeftOver:
        """Return what is left over when G (m, r, c) has coefficients of known size `sd` (c,)."""
        m, r, K = self.U.shape
        s, C = self.score(G * sd)
        values, vectors = np.linalg.eigh(C + np.eye(len(s)))
        root = vectors / np.sqrt(np.maximum(values, 1.0))
        white = self.whiten(G * sd).reshape(m * r, -1) @ root
        U = self.U.reshape(m * r, K)
        inside = U.T @ white
        new, along = white - U @ inside, root.T @ s
        return LeftOver(
            whitener=self.whitener,
            U=np.concatenate((U, new), axis=1).reshape(m, r, -1),
            white=self.white - (new @ along).reshape(m, r),
            chi2=self.chi2 - float(along @ along),
            to_x=np.concatenate((self.to_x, -self.to_x @ inside), axis=1),
            dof=self.dof,
        )


def left_over(
    w: FloatArray,
    A: FloatArray,
    V: FloatArray,
    *,
    drawn: FloatArray | None = None,
    prior_sd: FloatArray | None = None,
) -> LeftOver:
    """Fit a linear system and return what is left.

    Parameters
    ----------
    w, A, V
        Misclosures (m, r) with parameters that have a prior at its mean, Jacobian (m, r, P), and
        covariance (m, r, r).
    drawn
        Columns (m, r, c) of effects that are drawn once, each for a standard deviation of 1.
    prior_sd
        Standard deviation of what is known of each parameter (P,); inf where nothing is.
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
    seen = s > 1e-12 * s[0]
    U = Q[: m * r, seen]
    to_unknowns = (Wt[seen].T / s[seen]) / scale[:, None]
    along = U.T @ y
    left = y - U @ along
    return LeftOver(
        whitener=whitener,
        U=U.reshape(m, r, -1),
        white=left.reshape(m, r),
        chi2=float(y @ left),
        # w = -A dx: a column's coefficient is minus its parameter.
        to_x=to_unknowns[:P],
        dof=m * r - int(np.count_nonzero(precision == 0.0)),
    )

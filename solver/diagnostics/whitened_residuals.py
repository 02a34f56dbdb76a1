"""Whitened residuals of a linear fit, and the reduction of chi2 when further columns are fitted to them.

At the solution of a calibration the misclosures of all poses are

    w_i = -A_i dx + Z_i b + f_i,    f_i ~ N(0, V_i),    b ~ N(0, I),

with dx the parameters without a prior and b all other unknowns. V_i and Z_i follow from the variances of the fit. A
column holds the derivatives of the misclosures with respect to one unknown. In coordinates whitened by V_i, the
projector P = I - U U' removes everything that dx and b explain; U holds the fitted columns. Further columns G have the
score s = G'Pw with covariance C = G'PG. If they are fitted, chi2 falls by s'C^-1 s (Rao 1948): no refit is needed.

Columns of single poses, with coefficients ~ N(0, I), are further noise of these poses (`PoseNoise`). They change the
whitening of each pose alone, so one matrix as large as U'U is inverted, whatever the number of poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.estimators.linear_fit import inverse_root

FREE = 1e-9
"""A direction counts as already fitted if less than this share of its sum of squares remains after the fit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WhitenedResiduals:
    """Residuals of a fit of K columns (see the module) to m poses with r equations each.

    `whitener` (m, r, r): ``L^-1``, with ``L L' = V`` the covariance of a pose's noise.
    `U` (m, r, K): whitened fitted columns; together with the rows of the prior they are orthonormal.
    `white` (m, r): whitened misclosures ``L^-1 w`` minus their fitted part.
    `to_x` (P, K): maps coefficients of `U` to changes of the P parameters of the loop (rad, m).
    `dof`: number of equations minus number of parameters without a prior.
    """

    whitener: FloatArray
    U: FloatArray
    white: FloatArray
    chi2: float
    to_x: FloatArray
    dof: int

    def whiten(self, G: FloatArray) -> FloatArray:
        """Transform c columns (m, r, c) to whitened coordinates."""
        return np.asarray(self.whitener @ G)

    def score(self, G: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the score G'Pw (c,) of c columns G (m, r, c), and its covariance G'PG (c, c); see the module."""
        white = self.whiten(G).reshape(-1, G.shape[-1])
        inside = self.U.reshape(len(white), -1).T @ white
        return white.T @ self.white.reshape(-1), white.T @ white - inside.T @ inside

    def moved(self, G: FloatArray, b: FloatArray) -> FloatArray:
        """Return the change of the parameters (P,) if G (m, r, c) times b (c,) is subtracted from the misclosures."""
        white = (self.whiten(G) @ b).reshape(-1)
        return np.asarray(self.to_x @ (self.U.reshape(len(white), -1).T @ white))

    def with_columns(self, G: FloatArray, sd: FloatArray | None = None) -> WhitenedResiduals:
        """Return the residuals after the columns G (m, r, c) are fitted as well.

        `sd` (c,): standard deviations of the priors of the columns' coefficients; None if they have no prior.
        """
        m, r, K = self.U.shape
        G, prior = (G, 0.0) if sd is None else (G * sd, 1.0)
        white, U = self.whiten(G).reshape(m * r, -1), self.U.reshape(m * r, K)
        s, C = self.score(G)
        values, vectors = np.linalg.eigh(C + prior * np.eye(len(s)))
        values = np.maximum(values, prior)
        size = np.linalg.norm(white, axis=0).max(initial=1e-300) ** 2
        free = values > (FREE * size if sd is None else 0.0)
        root = vectors[:, free] / np.sqrt(values[free])
        inside, along = U.T @ white @ root, root.T @ s
        # In the metric of the prior's rows the new columns are orthogonal to the old ones.
        new = (white @ root - U @ inside).reshape(m, r, -1)
        return replace(
            self,
            U=np.concatenate((self.U, new), axis=-1),
            white=self.white - new @ along,
            chi2=self.chi2 - float(along @ along),
            to_x=np.concatenate((self.to_x, -self.to_x @ inside), axis=1),
            dof=self.dof - (int(free.sum()) if sd is None else 0),
        )

    def without(self, poses: IntArray) -> WhitenedResiduals:
        """Return the residuals of a fit without the poses with indices `poses`. All arrays keep their shapes.

        The whiteners and rows of these poses become zero. The fitted columns become orthonormal over the other rows.
        """
        own = self.U[poses].reshape(-1, self.U.shape[-1])
        values, vectors = np.linalg.eigh(np.eye(len(own)) - own @ own.T)
        free = values > FREE
        root = vectors[:, free] / np.sqrt(values[free])
        along = root.T @ self.white[poses].reshape(-1)
        # Deleting rows R turns U'U = I into the matrix I - R'R; with `inside` its inverse is I + inside inside'.
        inside = own.T @ root
        square, turn = np.linalg.eigh(inside.T @ inside)
        turned = inside @ turn
        stretched = turned / (1.0 + np.sqrt(1.0 + np.maximum(square, 0.0)))
        whitener, U = self.whitener.copy(), self.U + (self.U @ stretched) @ turned.T
        white = self.white + self.U @ (inside @ along)
        whitener[poses], U[poses], white[poses] = 0.0, 0.0, 0.0
        return WhitenedResiduals(
            whitener=whitener,
            U=U,
            white=white,
            chi2=self.chi2 - float(along @ along),
            to_x=self.to_x + (self.to_x @ stretched) @ turned.T,
            dof=self.dof - int(free.sum()),
        )


class PoseNoise:
    """Further noise of single poses: each of p poses has c columns whose coefficients b are ~ N(0, I).

    `poses` (p,): indices of the poses. `columns` (p, r, c): their columns, for r equations of each pose.
    `chi2`: chi2 of the residuals with this noise. `logdet`: ``log det (I + C)``, with C the covariance of the score.
    `moved` (P,): change of the parameters due to this noise, rad and m.
    """

    def __init__(self, residuals: WhitenedResiduals, poses: IntArray, columns: FloatArray) -> None:
        self._residuals, self._poses = residuals, poses
        self._W = residuals.whitener[poses] @ columns
        Wt = np.swapaxes(self._W, -1, -2)
        L = np.linalg.cholesky(np.eye(columns.shape[-1]) + Wt @ self._W)
        # With F = W L'^-1, the inverse of a pose's covariance I + W W' is I - F F'.
        self._L_inverse = np.linalg.inv(L)
        Ft = self._L_inverse @ Wt
        self._FtU = (Ft @ residuals.U[poses]).reshape(-1, residuals.U.shape[-1])
        score = (Ft @ residuals.white[poses][..., None]).reshape(-1)
        # U'U = I becomes I - (F'U)'(F'U).
        square = np.eye(self._FtU.shape[1]) - self._FtU.T @ self._FtU
        self._half, logdet = inverse_root(square)
        self._shift = self._half @ (self._half.T @ (self._FtU.T @ score))
        self._b = score + self._FtU @ self._shift
        self.chi2 = residuals.chi2 - float(score @ self._b)
        self.logdet = logdet + 2.0 * float(np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum())
        self.moved = np.asarray(residuals.to_x @ self._shift)

    def coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Return the most likely coefficients b (p * c,), pose by pose, and their variances (p * c,)."""
        back = np.swapaxes(self._L_inverse, -1, -2)
        p, c, _ = back.shape
        b = back @ self._b.reshape(p, c, 1)
        spread = back @ (self._FtU @ self._half).reshape(p, c, -1)
        return b.reshape(-1), ((back**2).sum(-1) + (spread**2).sum(-1)).reshape(-1)

    def residuals(self) -> WhitenedResiduals:
        """Return the residuals, whitened with this noise; the columns that are fitted stay the same."""
        past, own = self._residuals, self._poses
        covariance = np.eye(self._W.shape[1]) + self._W @ np.swapaxes(self._W, -1, -2)
        own_whitener = np.linalg.inv(np.linalg.cholesky(covariance))
        whitener, U, white = past.whitener.copy(), past.U.copy(), past.white + past.U @ self._shift
        for array in (whitener, U):
            array[own] = own_whitener @ array[own]
        white[own] = (own_whitener @ white[own][..., None])[..., 0]
        return replace(
            past,
            whitener=whitener,
            U=U @ self._half,
            white=white,
            chi2=self.chi2,
            to_x=past.to_x @ self._half,
        )

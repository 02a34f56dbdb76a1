"""Whitened residuals of a linear fit, and the reduction of chi2 when further columns are fitted to them.

At the solution of a calibration the misclosures of all poses are

    w_i = -A_i dx + Z_i b + f_i,    f_i ~ N(0, V_i),    b ~ N(0, I),

with dx the parameters without a prior and b all other unknowns. V_i and Z_i follow from the variances of the fit. A
column holds the derivatives of the misclosures with respect to one unknown. In coordinates whitened by V_i, the
projector P = I - U U' removes everything that dx and b explain; U holds the fitted columns. Further columns G have the
score s = G'Pw with covariance C = G'PG. If they are fitted, chi2 falls by s'C^-1 s (Rao 1948): no refit is needed.

Columns of single poses (`OwnColumns`) make T = G'G block diagonal. With W = G'U, C is T - W W'. By the matrix inversion
lemma, a solution with C then takes only one matrix as large as U'U, whatever the number of poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray

FREE = 1e-9
"""A direction counts as already fitted if the fit leaves less than this share of its sum of squares."""


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


ROUNDING = 1e-13
"""Smallest eigenvalue of ``I - W' W`` (see `OwnColumns.solved`) that is distinguishable from zero."""


class OwnColumns:
    """Further columns that concern single poses: each of p poses has c columns, with zeros in all other poses.

    The c whitened columns of each pose are rotated so that they are orthogonal to each other.

    `poses` (p,): indices of the poses.
    `white` (p, r, c): whitened columns before the rotation, for r equations of each pose.
    `rotation` (p, c, c): maps coefficients of the rotated columns to coefficients of `white`.
    `own` (p * c,): sum of squares of each rotated column. `score` (p * c,): its scalar product with the residuals.
    `overlap` (p * c, K): scalar products of the rotated columns with the K columns that are already fitted.
    """

    def __init__(self, residuals: WhitenedResiduals, poses: IntArray, columns: FloatArray) -> None:
        self.residuals, self.poses = residuals, poses
        self.white = residuals.whitener[poses] @ columns
        own, self.rotation = np.linalg.eigh(np.swapaxes(self.white, -1, -2) @ self.white)
        turned = np.swapaxes(self.white @ self.rotation, -1, -2)
        self.own = np.maximum(own, 0.0).reshape(-1)
        self.score = (turned @ residuals.white[poses][..., None]).reshape(-1)
        self.overlap = (turned @ residuals.U[poses]).reshape(own.size, -1)

    def solved(self, variance: float) -> SolvedColumns:
        """Solve for the coefficients of the rotated columns, each with the prior N(0, `variance`)."""
        from scipy.linalg import lapack

        total = 1.0 / variance + self.own
        root = np.sqrt(total)
        inside, score = self.overlap / root[:, None], self.score / root
        determined = np.eye(inside.shape[1]) - inside.T @ inside
        factor, failed = lapack.dpotrf(determined, lower=True)
        if failed:
            values, vectors = np.linalg.eigh(determined)
            factor = np.linalg.cholesky((vectors * np.maximum(values, ROUNDING)) @ vectors.T)
        back, _ = lapack.dtrtri(factor, lower=True)
        back = np.tril(back)
        b = (score + inside @ (back.T @ (back @ (inside.T @ score)))) / root
        return SolvedColumns(
            b=b,
            drop=float(self.score @ b),
            logdet=float(np.log(variance * total).sum())
            - 2.0 * float(np.log(np.diagonal(back)).sum()),
            total=total,
            back=back,
        )

    def coefficients(self, solved: SolvedColumns) -> tuple[FloatArray, FloatArray]:
        """Return the coefficients (p * c,) of the unrotated columns `white`, and the variances of the coefficients."""
        p, _, c = self.white.shape
        spread = self.overlap / solved.total[:, None] @ solved.back.T
        spread = self.rotation @ spread.reshape(p, c, -1)
        variance = (spread**2).sum(-1) + (self.rotation**2 / solved.total.reshape(p, 1, c)).sum(-1)
        b = (self.rotation @ solved.b.reshape(p, c, 1)).reshape(-1)
        return b, variance.reshape(-1)

    def moved(self, solved: SolvedColumns) -> FloatArray:
        """Return the change of the parameters (P,) when the columns are fitted with the coefficients `solved`."""
        return np.asarray(self.residuals.to_x @ (self.overlap.T @ solved.b))

    def as_noise(self) -> WhitenedResiduals:
        """Return the residuals for a model with the columns as further noise of `poses`; coefficients are ~ N(0, 1)."""
        residuals, solved = self.residuals, self.solved(1.0)
        b = (self.rotation @ solved.b.reshape(len(self.poses), -1, 1))[..., 0]
        white = residuals.white + residuals.U @ (self.overlap.T @ solved.b)
        white[self.poses] -= (self.white @ b[..., None])[..., 0]
        noise = np.linalg.cholesky(
            np.eye(self.white.shape[1]) + self.white @ np.swapaxes(self.white, -1, -2)
        )
        noise_whitener = np.linalg.inv(noise)
        white[self.poses] = (np.swapaxes(noise, -1, -2) @ white[self.poses][..., None])[..., 0]
        whitener, U = residuals.whitener.copy(), residuals.U.copy()
        whitener[self.poses] = noise_whitener @ whitener[self.poses]
        U[self.poses] = noise_whitener @ U[self.poses]
        return WhitenedResiduals(
            whitener=whitener,
            U=U @ solved.back.T,
            white=white,
            chi2=residuals.chi2 - solved.drop,
            to_x=residuals.to_x @ solved.back.T,
            dof=residuals.dof,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolvedColumns:
    """Coefficients of the rotated columns of an `OwnColumns`, each fitted with the prior N(0, v).

    `b` (p * c,): the coefficients, c for each of p poses. `drop`: reduction of chi2 by the fit.
    `logdet`: ``log det (I + v C)``, with C the covariance of the score (see the module).
    `total` (p * c,): information on each coefficient, from the prior and from the pose: ``1 / v + own``.
    `back` (K, K): triangular root, ``back' back = (I - W' D W)^-1``, with D = diag(1 / total), W = `overlap`, and K the
    number of columns fitted before. The covariance of `b` is ``D + D W back' back W' D``.
    """

    b: FloatArray
    drop: float
    logdet: float
    total: FloatArray
    back: FloatArray

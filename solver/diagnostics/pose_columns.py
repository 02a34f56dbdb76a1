"""Columns that touch one pose each, however many: what they would explain of what a fit left over.

A reading that is wrong in every pose in its own way, or poses of which nothing is believed, are as many columns as
there are such poses, and all of them but a block is zero. With T what a block is by itself and W what the fit's own
columns take of it, C = T - W W', and by the matrix inversion lemma everything is had from a matrix as large as the
fit has columns: nothing grows with the square of the poses. Knows no cause and no words.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.diagnostics.whitened_residuals import LeftOver

ROUNDING = 1e-13
"""Share of what the fit's columns take of a direction that is told from none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OwnColumns:
    """Whitened columns of some poses, each pose's turned so that they are at right angles to each other.

    Attributes
    ----------
    poses
        (p,) indices.
    white, turn
        (p, r, c) columns, and (p, c, c) from the turned coefficients to their own.
    own, score
        (p * c,) squares and scores of the turned columns.
    inside
        (p * c, K) what the fit's columns have of them.
    """

    poses: IntArray
    white: FloatArray
    turn: FloatArray
    own: FloatArray
    score: FloatArray
    inside: FloatArray

    @classmethod
    def of(cls, left: LeftOver, poses: IntArray, columns: FloatArray) -> OwnColumns:
        """Look at the columns (p, r, c) of `poses`."""
        white = left.whitener[poses] @ columns
        own, turn = np.linalg.eigh(np.swapaxes(white, -1, -2) @ white)
        turned = np.swapaxes(white @ turn, -1, -2)
        return cls(
            poses=poses,
            white=white,
            turn=turn,
            own=np.maximum(own, 0.0).reshape(-1),
            score=(turned @ left.white[poses][..., None]).reshape(-1),
            inside=(turned @ left.U[poses]).reshape(own.size, -1),
        )

    def solved(self, variance: float) -> SolvedColumns:
        """Solve for coefficients of this variance."""
        from scipy.linalg import lapack

        total = 1.0 / variance + self.own
        root = np.sqrt(total)
        inside, score = self.inside / root[:, None], self.score / root
        left = np.eye(inside.shape[1]) - inside.T @ inside
        factor, failed = lapack.dpotrf(left, lower=True)
        if failed:
            values, vectors = np.linalg.eigh(left)
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
        """Coefficients (p * c,) as they were before they were turned, and their variances."""
        p, _, c = self.white.shape
        spread = self.inside / solved.total[:, None] @ solved.back.T
        spread = self.turn @ spread.reshape(p, c, -1)
        variance = (spread**2).sum(-1) + (self.turn**2 / solved.total.reshape(p, 1, c)).sum(-1)
        b = (self.turn @ solved.b.reshape(p, c, 1)).reshape(-1)
        return b, variance.reshape(-1)

    def moved(self, left: LeftOver, solved: SolvedColumns) -> FloatArray:
        """By how much the parameters (P,) change when these are believed."""
        return np.asarray(left.to_x @ (self.inside.T @ solved.b))

    def drawn(self, left: LeftOver) -> LeftOver:
        """Return what is left over when their coefficients are drawn with variance 1: noise of these poses."""
        solved = self.solved(1.0)
        b = (self.turn @ solved.b.reshape(len(self.poses), -1, 1))[..., 0]
        white = left.white + left.U @ (self.inside.T @ solved.b)
        white[self.poses] -= (self.white @ b[..., None])[..., 0]
        noise = np.linalg.cholesky(
            np.eye(self.white.shape[1]) + self.white @ np.swapaxes(self.white, -1, -2)
        )
        quiet = np.linalg.inv(noise)
        white[self.poses] = (np.swapaxes(noise, -1, -2) @ white[self.poses][..., None])[..., 0]
        whitener, U = left.whitener.copy(), left.U.copy()
        whitener[self.poses] = quiet @ whitener[self.poses]
        U[self.poses] = quiet @ U[self.poses]
        return LeftOver(
            whitener=whitener,
            U=U @ solved.back.T,
            white=white,
            chi2=left.chi2 - solved.drop,
            to_x=left.to_x @ solved.back.T,
            dof=left.dof,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolvedColumns:
    """Turned coefficients (p * c,), how far chi2 falls by them, and log det (1 + variance C).

    Their covariance is ``D + D W back' back W' D`` with D = diag(1 / total); `back` (K, K) is the inverse root of
    what is left of the fit's columns when these poses are as noisy.
    """

    b: FloatArray
    drop: float
    logdet: float
    total: FloatArray
    back: FloatArray

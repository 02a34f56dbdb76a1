"""Outliers: poses that the others do not predict, from one linear fit.

The most improbable pose is set aside and the rest tested again, so that several do not hide each other; of many
poses several are set aside at a time, so that the work grows with their number. Nothing is excluded here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray
from solver.diagnostics.limits import FALSE_ALARM_PROBABILITY, OUTLIER_LARGEST_SHARE
from solver.diagnostics.whitened_residuals import WhitenedResiduals

ROUNDS = 100
"""Most rounds of setting poses aside, approximately."""

ALIKE = 0.5
"""Poses set aside with the worst one exceed the threshold by at least this share of its excess."""

FREE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlier:
    """One pose against the prediction from the poses that are no outliers.

    Attributes
    ----------
    pose
        Index, in the order of the fit.
    chi2, dof
        Misfit of the pose.
    threshold
        Value that the largest misfit of all poses exceeds in `FALSE_ALARM_PROBABILITY` of sound sets.
    """

    pose: int
    chi2: float
    dof: int
    threshold: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outliers:
    """The worst pose, all poses beyond the threshold (worst first), and the residuals of the others."""

    worst: Outlier
    odd: tuple[Outlier, ...]
    rest: WhitenedResiduals


def find_outliers(left: WhitenedResiduals, *, scale: float = 1.0) -> Outliers:
    """Test every pose against the others; `scale` is that of the variances (see `noise_scale`)."""
    from scipy.special import chdtri

    m = len(left.U)
    most = int(np.ceil(OUTLIER_LARGEST_SHARE * m))
    at_once = -(-most // ROUNDS)
    kept = np.ones(m, dtype=np.bool_)
    odd: list[Outlier] = []
    first: Outlier | None = None
    rest = left
    while True:
        chi2, dof = _misfits(rest, kept)
        limit = chdtri(np.maximum(dof, 1), FALSE_ALARM_PROBABILITY / m)
        excess = np.where(kept & (dof > 0), chi2 / scale - limit, -np.inf)
        worst = np.argsort(-excess, kind="stable")[:at_once]
        found = [
            Outlier(
                pose=int(k), chi2=float(chi2[k]) / scale, dof=int(dof[k]), threshold=float(limit[k])
            )
            for k in worst
        ]
        first = first or found[0]
        largest = float(excess[worst[0]])
        if not largest > 0.0 or len(odd) >= most:
            break
        some = worst[excess[worst] >= ALIKE * largest][: most - len(odd)]
        odd += found[: len(some)]
        kept[some] = False
        rest = rest.without(some)
    odd.sort(key=lambda pose: -pose.chi2)
    return Outliers(worst=first, odd=tuple(odd), rest=rest)


def pose_columns(left: WhitenedResiduals, poses: IntArray) -> FloatArray:
    """Separate columns (p, r, r) that free all equations of the poses (p,), in units of their noise."""
    return np.asarray(np.linalg.inv(left.whitener[poses]))


def leave_one_out_chi2(left: WhitenedResiduals) -> tuple[FloatArray, FloatArray]:
    """Misfit of every pose from the prediction by all others, and its degrees of freedom, (m,) each."""
    return _misfits(left, np.ones(len(left.U), dtype=np.bool_))


def _misfits(left: WhitenedResiduals, kept: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Misfit of every pose from the prediction by the others, and its degrees of freedom, (m,) each."""
    r = left.U.shape[1]
    H = np.eye(r) - left.U @ np.swapaxes(left.U, -1, -2)
    values, vectors = np.linalg.eigh(H)
    free = values > FREE
    along = (np.swapaxes(vectors, -1, -2) @ left.white[..., None])[..., 0]
    chi2 = np.where(free, along**2 / np.where(free, values, 1.0), 0.0).sum(-1)
    return np.where(kept, chi2, 0.0), np.where(kept, free.sum(-1), 0)

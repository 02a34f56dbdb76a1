"""Predicts later poses from fitted ones, and tests for a common shift of one joint or the fixture between them.

One mixed model of both: what the first poses determine of parameters and of effects that are drawn once (sensor
curves, harmonics, sag, compliance) is the prior of the later ones, covariance included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.diagnostics.limits import FALSE_ALARM_PROBABILITY
from solver.diagnostics.whitened_residuals import WhitenedResiduals
from solver.estimators.linear_fit import LinearFit

NOT_KNOWN = 0.1
"""Prior standard deviation (rad, m) of parameters that only the poses determine."""


SEEN = 1e-9
"""Share of the largest information below which a direction is not determined."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedParameters:
    """Fixed parameters that have no prior: values (P,) and covariance (P, P)."""

    x: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonShift:
    """A shift of one subject, common to all later poses.

    Attributes
    ----------
    subject
        Joint or side of the fixture that was tested.
    size, sigma
        Size of the shift and its standard deviation, where it is one number.
    chi2, threshold
        Reduction of chi2, and the value that chance reaches in `FALSE_ALARM_PROBABILITY` of sound sets.
    """

    subject: str
    size: float | None
    sigma: float | None
    chi2: float
    threshold: float


def predicted_residuals(
    fit: LinearFit, later: BoolArray, given: FixedParameters | None = None
) -> WhitenedResiduals:
    """Return the residuals of the `later` poses (m,), predicted from the other poses of `fit`.

    Parameters
    ----------
    given
        Fixed parameters, tested as they are instead of by their poses.
    """
    width, hard = fit.design.width, fit.design.hard
    gram, right = np.zeros((width, width)), np.zeros(width)
    whitener, M, w = [], [], []
    for part in fit.parts():
        new = later[part.poses]
        before = part.M[~new].reshape(-1, width)
        gram += before.T @ before
        right += part.w[~new].reshape(-1) @ before
        whitener.append(part.L_inverse[new])
        M.append(part.M[new])
        w.append(part.w[new])
    if given is None:
        precision = np.repeat((NOT_KNOWN**-2, 1.0), (hard, width - hard))
        half = _root_of_inverse(gram + np.diag(precision))
        coefficients = -(half @ (half.T @ right))
    else:
        values, vectors = np.linalg.eigh(given.covariance)
        half, coefficients = np.eye(width), np.zeros(width)
        half[:hard, :hard] = vectors * np.sqrt(np.maximum(values, 0.0))
        coefficients[:hard] = given.x
    columns = np.concatenate(M)
    m, r, _ = columns.shape
    N = columns.reshape(m * r, width) @ half
    y = np.concatenate(w).reshape(-1) + columns.reshape(m * r, width) @ coefficients
    # (I + N N')^-1 = I - U U'
    U = N @ _root_of_inverse(np.eye(width) + N.T @ N)
    white = y - U @ (U.T @ y)
    return WhitenedResiduals(
        whitener=np.concatenate(whitener),
        U=U.reshape(m, r, width),
        white=white.reshape(m, r),
        chi2=float(y @ white),
        to_x=np.zeros((0, width)),
        dof=m * r,
    )


def shifted(left: WhitenedResiduals, subjects: Mapping[str, FloatArray]) -> CommonShift | None:
    """Return the most significant of the columns (m, r, c) common to all poses; None where none is significant."""
    from scipy.special import chdtri

    found = []
    for name, columns in subjects.items():
        s, information = left.score(columns)
        values, vectors = np.linalg.eigh(information)
        seen = values > SEEN * max(float(values[-1]), 1e-300)
        chi2 = float(((vectors.T @ s)[seen] ** 2 / values[seen]).sum())
        single = columns.shape[-1] == 1 and bool(seen.all())
        threshold = float(chdtri(max(int(seen.sum()), 1), FALSE_ALARM_PROBABILITY / len(subjects)))
        found.append(
            CommonShift(
                subject=name,
                size=float(s[0] / values[0]) if single else None,
                sigma=float(values[0] ** -0.5) if single else None,
                chi2=chi2,
                threshold=threshold,
            )
        )
    best = max(found, key=lambda shift: shift.chi2 - shift.threshold, default=None)
    return best if best is not None and best.chi2 > best.threshold else None


def _root_of_inverse(H: FloatArray) -> FloatArray:
    """K with ``H^-1 = K K'``."""
    unit = 1.0 / np.sqrt(np.diagonal(H))
    values, vectors = np.linalg.eigh(H * unit[:, None] * unit)
    values = np.maximum(values, 1e-14 * values[-1])
    return np.asarray(unit[:, None] * vectors / np.sqrt(values))

"""The implicit fit from several starts; a start that does not converge is no exception."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.diagnostics.limits import (
    CHI2_PER_DOF_SECOND_START,
    OTHER_START_MISFIT_SHARE,
)
from solver.errors import PosesDoNotFitError
from solver.estimators.error_model import ErrorModel
from solver.estimators.least_squares import Progress
from solver.estimators.variance_components import Calibrated, estimate_with_errors
from solver.loops.closure import ClosureModel

FEW = 600
"""Poses, evenly among all, that tell which of several starts is the best one."""


def fit_from_starts(
    model: ClosureModel,
    q: FloatArray,
    errors: ErrorModel,
    starts: Iterable[FloatArray | None],
    *,
    group: IntArray,
    progress: Progress | None = None,
) -> Calibrated:
    """Fit from each start until one leads to readings as they are stated; return the best.

    Raises
    ------
    PosesDoNotFitError
        No start leads to anything.
    """
    starts, several = iter(starts), len(q) > 2 * FEW
    first = islice(starts, 1) if several else starts
    found, least = _best(model, q, errors, first, group=group, progress=progress)
    if several and not least < CHI2_PER_DOF_SECOND_START:
        some = evenly(len(q), FEW)
        few, misfit = _best(
            model.at_poses(some),
            q[some],
            errors.at_poses(some),
            starts,
            group=group[some],
            progress=None,
        )
        if few is not None and misfit < OTHER_START_MISFIT_SHARE * least:
            again = (few.estimate.x,)
            other, left = _best(model, q, errors, again, group=group, progress=progress)
            found = other if left < least else found
    if found is None:
        raise PosesDoNotFitError
    return found


def evenly(poses: int, most: int) -> IntArray:
    """Indices of `most` of so many poses."""
    return np.linspace(0, poses - 1, min(most, poses)).astype(np.int64)


def _best(
    model: ClosureModel,
    q: FloatArray,
    errors: ErrorModel,
    starts: Iterable[FloatArray | None],
    *,
    group: IntArray,
    progress: Progress | None,
) -> tuple[Calibrated | None, float]:
    """Return the best fit of some starts, or the first that is good enough, and its misfit; None where none is."""
    best: Calibrated | None = None
    least = np.inf
    for x0 in starts:
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                found = estimate_with_errors(
                    model, q, errors, x0=x0, group=group, progress=progress
                )
                misfit = gross_misfit(found)
        except (PosesDoNotFitError, np.linalg.LinAlgError):
            continue
        if misfit < least:
            best, least = found, misfit
        if least < CHI2_PER_DOF_SECOND_START:
            break
    return best, least


def gross_misfit(found: Calibrated) -> float:
    """chi2/dof at stated variances; infinite where it is no number."""
    ratio = found.linear.stated.chi2 / max(found.linear.dof, 1)
    return float(ratio) if np.isfinite(ratio) else np.inf

"""What a pose set can see, by the equations that a fit ended at: no loop is closed once more.

Knows linear fits; no screen. `solver.diagnostics.identifiability` judges poses of which there is no fit.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from solver.arrays import IntArray
from solver.closing import left_null_space
from solver.diagnostics.identifiability import Identifiability, judge_jacobian
from solver.estimators.linear_fit import LinearFit


def seen_by_fit(
    fit: LinearFit,
    names: tuple[str, ...],
    *,
    taken: IntArray,
    without: Collection[int] = (),
) -> Identifiability:
    """Judge what the poses of `fit` see of the unknowns `names`, all others being known.

    Parameters
    ----------
    taken
        (m,): when each pose of the fit was taken, its place among the others.
    without
        Joints (1-based) whose readings are taken out.
    """
    system, model, q = fit.whole, fit.design.model, fit.design.q
    lost = [j - 1 for j in without if j not in model.unsensed_joints]
    every = [p.name for p in model.parameters]
    J = system.A[..., [every.index(name) for name in names]]
    if lost:
        J = np.swapaxes(left_null_space(system.B[..., lost]), -1, -2) @ J
    J = J[np.argsort(taken, kind="stable")]
    return judge_jacobian(
        J.reshape(-1, len(names)), names, poses=len(q), spans_rad=np.ptp(q, axis=0)
    )

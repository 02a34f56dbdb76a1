"""Has what refuses a calibration led its solution astray? Advice that is drawn from such a solution is not said.

Knows causes, parameters and their sigmas; no readings and no screen.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from operator_app.calibration.causes import NamedCause
from operator_app.calibration.local_minima import far_from_nominal
from solver.arrays import FloatArray
from solver.diagnostics.limits import CHI2_PER_DOF_REFUSED, USELESS_SIGMA_M, USELESS_SIGMA_RAD
from solver.estimators.estimate import Estimate

OF_THE_SOLUTION = ("LITTLE_MOTION", "FAR_FROM_NOMINAL", "PARALLEL_AXES", "NOT_CONVERGED")
"""Causes that are read off the solution itself: they lead nothing astray."""


def has_diverged(
    causes: Iterable[NamedCause], scale: float, estimate: Estimate, judged: tuple[str, ...]
) -> bool:
    """Whether a gross cause refuses, and the solution is where no file would have it or known to nobody's use.

    Parameters
    ----------
    scale
        chi2/dof at stated variances.
    judged
        Names of the parameters that were looked for.
    """
    # A local optimum is astray however well it fits.
    if not any(
        c.refuses
        and (c.code == "OTHER_SOLUTION" or scale > CHI2_PER_DOF_REFUSED)
        and c.code not in OF_THE_SOLUTION
        for c in causes
    ):
        return False
    # Of several placements the fixture's file can describe one.
    here = [p.name in judged and not p.name.endswith("]") for p in estimate.parameters]
    chosen = tuple(p for p, yes in zip(estimate.parameters, here, strict=True) if yes)
    sd: FloatArray = estimate.standard_deviation[here]
    worthless = np.where([p.is_angle for p in chosen], USELESS_SIGMA_RAD, USELESS_SIGMA_M)
    return bool((~(sd <= worthless)).any()) or bool(far_from_nominal(chosen, estimate.x[here], sd))

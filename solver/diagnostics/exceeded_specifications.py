"""Which stated sources of error the data show to be larger than stated, all of them fitted at once.

Where several are, no single one explains what is left over; together they may. Knows a fit and its
variance components; no words.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.estimators.component_report import MOST_CERTAIN, standard_errors
from solver.estimators.linear_fit import LinearFit
from solver.estimators.scoring import with_priors

FALSE_ALARM = 1e-3
"""Chance of naming any source of a set in which all are as stated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Larger:
    """One source.

    Attributes
    ----------
    component
        Its name in the error model.
    times
        How many times the stated standard deviation was found.
    log_chance
        Logarithm of the chance of finding it so large where it is as stated.
    """

    component: str
    times: float
    log_chance: float


def larger_than_stated(fit: LinearFit) -> tuple[Larger, ...]:
    """Name the sources found larger than stated for certain, the nearest to its statement first.

    A source twice as large as stated happens oftener than one that is ten times as large.

    A variance found with standard error s is distributed as chi2 with ``2 v^2 / s^2`` degrees of freedom
    (Satterthwaite).
    """
    from scipy.special import chdtrc

    design, v = fit.design, fit.v
    stated = design.stated_variances()
    error = standard_errors(with_priors(fit).information, v, design.floors)
    found = []
    for c, value, least, s in zip(design.components, v, stated, error, strict=True):
        if c.name in ("discrepancy", "placement") or not value > least > 0.0 or not np.isfinite(s):
            continue
        dof = 2.0 * min(value / max(float(s), 1e-300), MOST_CERTAIN) ** 2
        # Wilson and Hilferty's cube root where the chance is too small for a double.
        chance = float(chdtrc(dof, dof * value / least))
        cube = ((value / least) ** (1.0 / 3.0) - 1.0 + 2.0 / (9.0 * dof)) / np.sqrt(
            2.0 / (9.0 * dof)
        )
        log_chance = float(np.log(chance)) if chance > 1e-300 else float(-0.5 * cube**2)
        found.append(
            Larger(component=c.name, times=float(np.sqrt(value / least)), log_chance=log_chance)
        )
    level = np.log(FALSE_ALARM / max(len(design.components), 1))
    return tuple(sorted((x for x in found if x.log_chance < level), key=lambda x: x.times))

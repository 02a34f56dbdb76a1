"""Sensitivity of the largest sigmas: the main source of each, and the sigma if the error from that source were halved.

If a source's standard deviation is halved, at unchanged weights, the variance falls by 3/4 of the source's share.
"""

from dataclasses import dataclass

import numpy as np

from operator_app.calibration.result import Solution
from operator_app.messages.finding import source_remedy
from solver.chain.parameters import Parameter
from solver.diagnostics.limits import COARSE_SIGMA_M, COARSE_SIGMA_RAD

WORST = 3
"""Number of least certain parameters that are reported."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceSensitivity:
    """Sensitivity of one parameter's standard deviation `sigma` (rad or m) to its main source of error.

    `share`: share of the variance that comes from `source`. `then`: sigma if the error from this source were halved.
    """

    parameter: Parameter
    sigma: float
    source: str
    share: float
    then: float
    remedy: str


def source_sensitivities(solution: Solution) -> tuple[SourceSensitivity, ...]:
    """Return the main source of error of each of the `WORST` parameters with the largest uncertainties.

    The result is empty without an uncertainty budget, and for a diverged solution, on which no advice can be based.
    """
    if solution.components is None or solution.adjudication.diverged:
        return ()
    budget, estimate = solution.components.budget, solution.estimate
    sensitivities = []
    for k, (p, sd) in enumerate(
        zip(estimate.parameters, estimate.standard_deviation.tolist(), strict=True)
    ):
        if p.name in solution.tolerated or not budget or not sd > 0.0:
            continue
        source = max(budget, key=lambda name: float(budget[name][k]))
        part = float(budget[source][k])
        sensitivities.append(
            SourceSensitivity(
                parameter=p,
                sigma=sd,
                source=source,
                share=part / sd**2,
                then=float(np.sqrt(max(sd**2 - 0.75 * part, 0.0))),
                remedy=source_remedy(source),
            )
        )
    sensitivities.sort(
        key=lambda h: -h.sigma / (COARSE_SIGMA_RAD if h.parameter.is_angle else COARSE_SIGMA_M)
    )
    return tuple(sensitivities[:WORST])

"""What the operator can do about the widest sigmas: the largest source of each, and what less of it brings.

From the uncertainty budget alone: with a source's standard deviation halved and the poses weighed as now
the variance falls by three quarters of its share (weighed anew it can only fall further). Knows a
calibration; no renderer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from operator_app.calibration.result import Solution
from solver.chain.parameters import Parameter
from solver.diagnostics.limits import COARSE_SIGMA_M, COARSE_SIGMA_RAD
from solver.diagnostics.stated_sizes import exceeded_specifications
from solver.estimators.variance_components import Calibrated

WORST = 3
"""So many parameters are worth a sentence."""

REMEDIES = {
    "lengths": "measure the arm's lengths twice as well and state their tolerance",
    "twists": "measure the arm's twists twice as well and state their tolerance",
    "offsets": "find the joints' zeros another way and state offset_tolerance_deg",
    "placement": "measure where the fixture stands twice as well and state its tolerance",
    "encoder_accuracy": "centre the encoders twice as well and state their accuracy_deg",
    "fixture_give": "mount a fixture twice as stiff, or pull less at it, and state its give",
    "joint_play": "take half of the joints' play out and state it",
    "sag": "state the links' masses, or how much less the joints sag",
    "distances": "measure the distances of the sockets twice as well and state their sigma_mm",
    "discrepancy": "find what bends with the pose that no file states",
    "counts": "fit encoders of more counts: one that stands still reads alike however often it is asked",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceSensitivity:
    """One parameter: its sigma, the source that brings most of it, and what is left with half of that.

    `sigma` and `then` are in rad or m, `share` is of the variance.
    """

    parameter: Parameter
    sigma: float
    source: str
    share: float
    then: float
    remedy: str


def source_sensitivities(solution: Solution) -> tuple[SourceSensitivity, ...]:
    """Say of the parameters that are known worst what would help most; empty without a budget.

    So it is where the solution is astray: stiffer fixtures and longer samples lead nothing back.
    """
    if solution.components is None or solution.judgement.diverged:
        return ()
    budget, estimate = solution.components.budget, solution.estimate
    found = []
    for k, (p, sd) in enumerate(
        zip(estimate.parameters, estimate.standard_deviation.tolist(), strict=True)
    ):
        if p.name in solution.tolerated or not budget or not sd > 0.0:
            continue
        source = max(budget, key=lambda name: float(budget[name][k]))
        part = float(budget[source][k])
        found.append(
            SourceSensitivity(
                parameter=p,
                sigma=sd,
                source=source,
                share=part / sd**2,
                then=float(np.sqrt(max(sd**2 - 0.75 * part, 0.0))),
                remedy=remedy_of(source),
            )
        )
    found.sort(
        key=lambda h: -h.sigma / (COARSE_SIGMA_RAD if h.parameter.is_angle else COARSE_SIGMA_M)
    )
    return tuple(found[:WORST])


def remedy_beside_poses(found: Calibrated, name: str) -> str:
    """What else than other poses narrows a parameter's sigma: where most of it is a source larger than stated.

    Empty where none is: what is as stated, poses that differ more see through.
    """
    budget, names = found.components.budget, [p.name for p in found.estimate.parameters]
    if not budget or name not in names:
        return ""
    k = names.index(name)
    source = max(budget, key=lambda s: float(budget[s][k]))
    if not 2.0 * float(budget[source][k]) > float(found.estimate.covariance[k, k]):
        return ""
    larger = {x.component for x in exceeded_specifications(found.linear)}
    sources = {c.source for c in found.linear.design.components if c.name in larger}
    return remedy_of(source) if source in sources else ""


def remedy_of(source: str) -> str:
    """What halves a source of the budget."""
    joint = source.rpartition("_")[2]
    if source.startswith("rvdt_curve_"):
        return f"replace the RVDT of joint {joint} or take its curve on a bench"
    if source.startswith("rvdt_gain_"):
        return f"have the scale factor of joint {joint}'s RVDT set twice as well and state its gain"
    if source.startswith("rvdt_noise_"):
        return f"take four times as many samples of joint {joint} in every pose"
    return REMEDIES.get(source, "take more poses that differ more")

"""Distances between the sockets of a ball, with their uncertainty, beside those that were measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fixtures.ball import KnownDistance
from fixtures.base import EndpointConstraint
from operator_app.calibration.error_model import stated_distances
from solver.chain.poses import PoseSet
from solver.diagnostics.limits import DISTANCE_NOTICE_PROBABILITY
from solver.estimators.estimate import Estimate
from solver.estimators.linear_fit import LinearFit
from solver.estimators.measured_distances import distance_and_rates
from solver.loops.closure import ClosureModel
from solver.loops.point import GROUND, PointClosure

MOST = 45
"""Pairs of ten placements; of more only neighbours are listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distance:
    """Distance of two placements' points (numbers of placements), m, and its standard uncertainty.

    `measured` is what the fixture's file states of it, if anything, and counts in the distance as well; `deviation`
    is how far that is above what the poses alone say, in sigmas of the difference.
    """

    between: tuple[int, int]
    value_m: float
    sigma_m: float
    measured: KnownDistance | None = None
    deviation: float = 0.0


def distances(
    model: ClosureModel,
    estimate: Estimate,
    placements: tuple[int, ...],
    measured: Sequence[tuple[KnownDistance, float]] = (),
) -> tuple[Distance, ...]:
    """Return the distances between the sockets of a ball; empty for other fixtures, or one placement.

    `measured` are those that took part in the estimate, each with its deviation.
    """
    parts = model.parts()
    if len(parts) < 2 or not all(isinstance(part, PointClosure) for part, _, _ in parts):
        return ()
    columns = np.arange(len(estimate.x))
    where = []
    for part, own, _ in parts:
        names = [p.name for p in part.parameters]
        if not set(GROUND) <= set(names):
            return ()
        where.append(columns[own][[names.index(name) for name in GROUND]])
    stated = {frozenset(d.between): (d, off) for d, off in measured}
    pairs = [
        (a, b)
        for a, b in combinations(range(len(where)), 2)
        if len(where) * (len(where) - 1) <= 2 * MOST
        or b == a + 1
        or frozenset((placements[a], placements[b])) in stated
    ]
    found = []
    for a, b in pairs:
        value, rates = distance_and_rates(where[a].tolist(), where[b].tolist(), estimate.x)
        between = (placements[a], placements[b])
        known, deviation = stated.get(frozenset(between), (None, 0.0))
        found.append(
            Distance(
                between=between,
                value_m=value,
                sigma_m=math.sqrt(max(float(rates @ estimate.covariance @ rates), 0.0)),
                measured=known,
                deviation=deviation,
            )
        )
    return tuple(found)


def compared(
    fixture: EndpointConstraint, poses: PoseSet, fit: LinearFit
) -> tuple[tuple[KnownDistance, float], ...]:
    """Return the measured distances that took part in a fit of these poses, each with its deviation."""
    stated = stated_distances(fixture, poses.placements)
    return tuple(zip(stated, fit.distance_deviations().tolist(), strict=True))


def contradicted(found: Sequence[Distance]) -> tuple[Distance, ...]:
    """Return the measured distances that the poses contradict."""
    from scipy.special import ndtri

    known = sum(d.measured is not None for d in found)
    limit = -float(ndtri(0.5 * DISTANCE_NOTICE_PROBABILITY / max(known, 1)))
    return tuple(d for d in found if abs(d.deviation) > limit)

"""Distances between the placements of a fixture, with their uncertainty: what a caliper can check.

Knows calibrations; no file and no screen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solver.estimators.estimate import Estimate
from solver.loops.closure import ClosureModel
from solver.loops.point import GROUND, PointClosure

MOST = 45
"""Pairs of ten placements; of more only neighbours are listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distance:
    """Distance of two placements' points (numbers of placements), m, and its standard deviation."""

    between: tuple[int, int]
    value_m: float
    sigma_m: float


def distances(
    model: ClosureModel, estimate: Estimate, placements: tuple[int, ...]
) -> tuple[Distance, ...]:
    """Return the distances between the sockets of a ball; empty for other fixtures, or one placement."""
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
    pairs = list(combinations(range(len(where)), 2))
    if len(pairs) > MOST:
        pairs = [(k, k + 1) for k in range(len(where) - 1)]
    found = []
    for a, b in pairs:
        apart = estimate.x[where[b]] - estimate.x[where[a]]
        value = float(np.linalg.norm(apart))
        along = np.concatenate((-apart, apart)) / max(value, 1e-300)
        both = np.concatenate((where[a], where[b]))
        variance = along @ estimate.covariance[np.ix_(both, both)] @ along
        found.append(
            Distance(
                between=(placements[a], placements[b]),
                value_m=value,
                sigma_m=float(np.sqrt(np.maximum(variance, 0.0))),
            )
        )
    return tuple(found)

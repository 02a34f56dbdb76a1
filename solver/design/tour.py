"""A short way through points that are all to be visited. Knows distances only."""

from __future__ import annotations

import numpy as np

from solver.arrays import FloatArray

FAR_RAD = 1e3
"""Stands for a distance that does not exist: far, yet not so far that rounding hides the rest."""
MOST_ROUNDS = 50
"""Of 2-opt; ten are many."""


def visiting_order(distances: FloatArray) -> tuple[int, ...]:
    """Short open tour through all points from point 0, by nearest neighbour and 2-opt.

    Parameters
    ----------
    distances
        (k, k), symmetric; inf where there is no way.

    Returns
    -------
    Points 1..k-1 in visiting order.
    """
    size = len(distances)
    finite = np.where(np.isfinite(distances), distances, FAR_RAD)
    tour, left = [0], set(range(1, size))
    while left:
        tour.append(min(left, key=lambda p: (float(finite[tour[-1], p]), p)))
        left.remove(tour[-1])
    for _ in range(MOST_ROUNDS):
        improved = False
        for a in range(1, size - 1):
            for b in range(a + 1, size):
                old = finite[tour[a - 1], tour[a]]
                new = finite[tour[a - 1], tour[b]]
                if b + 1 < size:
                    old = old + finite[tour[b], tour[b + 1]]
                    new = new + finite[tour[a], tour[b + 1]]
                if new < old - 1e-9:
                    tour[a : b + 1] = reversed(tour[a : b + 1])
                    improved = True
        if not improved:
            break
    return tuple(tour[1:])

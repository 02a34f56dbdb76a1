"""A route as the moves and changes of drives that a campaign proposes. Knows no arm and no policy."""

from __future__ import annotations

import numpy as np

from solver.arrays import FloatArray
from solver.design.actions import ChangeDrives, GoTo
from solver.design.paths import Route


def moves_along(
    route: Route, drives: tuple[int, ...], tolerance_rad: float, goal: str, *, of: str = ""
) -> list[GoTo | ChangeDrives]:
    """Return moves along a route, with the changes of drives on it; `drives` are in position mode before it."""
    moves: list[GoTo | ChangeDrives] = []
    for leg in route.legs:
        if leg.drives != drives:
            drives = leg.drives
            why = f"joints {' and '.join(map(str, drives))} reach {goal}"
            moves.append(ChangeDrives(drives=drives, why=why))
        moves.extend(
            GoTo(
                targets_rad=leg.targets(k),
                trace_rad=leg.trace_rad,
                tolerance_rad=tolerance_rad,
                why=f"to {goal}{of}",
            )
            for k in range(len(leg.waypoints_rad))
        )
    return moves


def straight_to(q_rad: FloatArray, drives: tuple[int, ...], why: str) -> GoTo:
    """Return the straight move of the drives to where they are in `q_rad` (n,); nothing is predicted on the way."""
    return GoTo(
        targets_rad={j: float(q_rad[j - 1]) for j in drives},
        trace_rad=None,
        tolerance_rad=np.inf,
        why=why,
    )

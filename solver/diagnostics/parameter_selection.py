"""Parameters to fix at their nominal values so that a pose set determines the rest.

Of the parameters of an unidentifiable direction any one may be fixed, and the loop described is the same. An entry of
the arm's table is fixed before a parameter of the fixture: a wrong s_1 would be taken for the arm's.
"""

from __future__ import annotations

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops, reduced_jacobian
from solver.diagnostics.identifiability import identifiability_of_jacobian
from solver.errors import UnidentifiableDirection
from solver.estimators.least_squares import column_scale, solve_damped
from solver.estimators.paper import ClosureProblem
from solver.loops.closure import ClosureModel


def drop_unidentifiable(
    model: ClosureModel,
    x: FloatArray | None,
    q: FloatArray,
    *,
    sigma_rad: FloatArray | None = None,
) -> tuple[ClosureModel, tuple[str, ...]]:
    """Hold what the poses cannot see.

    Parameters
    ----------
    model
        The loop with every unknown one would like.
    x
        Where to judge (P,): parameters that nearly close the loops, because beside closed loops
        nothing looks unidentifiable. None: offsets and fixture fitted with the arm's lengths and
        twists at their nominal values (with all of those unknown a fit may shrink to nothing).
    q
        Joint angles (m, n), rad.
    sigma_rad
        Standard deviation of each joint's reading (n,), for closing the loops.

    Returns
    -------
    The loop with fewer unknowns, and the names of those now held at their nominal values. The others
    have to be estimated again: `x` belongs to other values of the held ones.
    """
    x = nearly_closing_parameters(model, q) if x is None else x
    poses = close_loops(model, x, q, sigma_rad=sigma_rad)
    A, _ = reduced_jacobian(model, x, poses.q, poses.u)
    J = A.reshape(-1, A.shape[-1])
    spans = np.ptp(poses.q, axis=0)
    names = [p.name for p in model.parameters]
    fixture = {*model.ground_side, *model.hand_side}
    left = list(range(len(names)))
    while left:
        here = [names[k] for k in left]
        found = identifiability_of_jacobian(J[:, left], tuple(here), poses=len(q), spans_rad=spans)
        if not found.directions:
            break
        del left[_choose(J[:, left], here, found.directions, fixture)]
    kept = {names[k] for k in left}
    dropped = tuple(name for name in names if name not in kept)
    return (model.without(dropped) if dropped else model), dropped


def nearly_closing_parameters(model: ClosureModel, q: FloatArray) -> FloatArray:
    """Parameters (P,) that nearly close the loops: offsets and fixture fitted, the rest nominal."""
    names = [p.name for p in model.parameters]
    fixture = {*model.ground_side, *model.hand_side}
    sensed = model.with_all_joints_sensed()
    plain = sensed.without(
        {n for n in names if n not in fixture and not n.startswith("theta_off_")}
    )
    start = nominal_vector(plain.parameters)
    fit = solve_damped(ClosureProblem.of(plain, q), start)
    fitted = dict(zip([p.name for p in plain.parameters], fit.x, strict=True))
    return np.array([fitted.get(p.name, p.nominal) for p in model.parameters])


def _choose(
    J: FloatArray,
    names: list[str],
    directions: tuple[UnidentifiableDirection, ...],
    fixture: set[str],
) -> int:
    """Index of the column to hold: a still joint's offset, else the arm's entry seen least."""
    for direction in directions:
        for joint in direction.immobile_joints:
            if f"theta_off_{joint}" in direction.parameters:
                return names.index(f"theta_off_{joint}")
    named = {name for direction in directions for name in direction.parameters}
    # Share of each parameter in the null space: what least squares cannot give it, of a unit wish.
    scaled = J / column_scale(J)
    share = 1.0 - np.diagonal(np.linalg.pinv(scaled, rcond=1e-7) @ scaled)
    order = sorted(
        (k for k in range(len(names)) if names[k] in named),
        key=lambda k: (names[k] in fixture, -round(float(share[k]), 6), k),
    )
    return order[0]

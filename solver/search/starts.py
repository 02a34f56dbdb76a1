"""Minimises from all starts of a global start in one batch, by damped Gauss-Newton iteration.

Every start has its own damping; starts that have converged leave the batch. `global_start` refines the results.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector, wrap_angle
from solver.estimators.least_squares import Progress
from solver.loops.closure import ClosureModel
from solver.search.inner import projectable_parts, spread_poses

HALT_AFTER = 8
SURVIVING_SHARE, FEWEST_SURVIVORS = 1.0 / 3.0, 30
"""After `HALT_AFTER` iterations only the best third of the starts continues. It includes 80 to 100 % of the starts
that would have reached the solution (random hinges, a ball), so with the same work twice as many starts reach it."""

SEARCH_EQUATIONS = 72
"""Number of closure equations that the search uses: a few times the unknowns of any usual arm."""

REFINED_MINIMA = 6
"""Number of minima that are refined: the cost of the true one is orders of magnitude below that of the next."""

SAME_MINIMUM = 0.02
"""Starts that end within this distance of each other (rad) count as one minimum."""


BatchProblem = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function from unknowns (S, K) to residuals (S, R) and Jacobian (S, R, K)."""

FIRST_DAMPING = 1e-2
EASIER, HARDER = 0.2, 5.0
STUCK_DAMPING = 1e7
STEP_TOLERANCE = 1e-7

BATCH_ITERATIONS, LONGEST_STEP_RAD = 40, 0.7
"""Largest number of iterations, and largest component of one step: beyond it a linearised rotation is invalid."""


def best_minima(
    model: ClosureModel,
    q: FloatArray,
    starts: int,
    rng: np.random.Generator,
    progress: Progress | None,
) -> list[tuple[FloatArray, int]]:
    """Minimise from all starts; return the best minima (P,), with the number of starts that ended in each."""
    parts, nominal = projectable_parts(model, q), nominal_vector(model.parameters)
    if not (parts and parts[0].searched):
        return _best_of_all_unknowns(model, q, starts, rng, progress)
    # The placement with the most poses determines the arm's offsets; the others only their own fixtures.
    largest = max(parts, key=lambda part: len(part.q))
    count = -(-SEARCH_EQUATIONS // model.equations_per_pose)
    few = replace(largest, q=spread_poses(largest.q, count))
    nominal_offsets = np.array([largest.table.theta_off_rad[j - 1] for j in largest.searched])
    x0 = np.concatenate(
        (nominal_offsets[None, :], rng.uniform(-np.pi, np.pi, (starts - 1, len(nominal_offsets))))
    )
    minima = []
    for offsets, starts_there in _minima(
        *_minimised(few, x0, progress), angles=range(len(nominal_offsets))
    ):
        x = nominal.copy()
        for part in parts:
            x[part.columns] = part.filled(offsets)
        minima.append((x, starts_there))
    return minima


def _best_of_all_unknowns(
    model: ClosureModel,
    q: FloatArray,
    starts: int,
    rng: np.random.Generator,
    progress: Progress | None,
) -> list[tuple[FloatArray, int]]:
    """Search over all unknowns, for models whose fixture cannot be projected out."""
    parameters = model.parameters
    turned = [k for k, p in enumerate(parameters) if p.name.startswith("theta_off_")]
    x0 = np.tile(nominal_vector(parameters), (starts, 1))
    x0[1:, turned] = rng.uniform(-np.pi, np.pi, (starts - 1, len(turned)))

    def problem(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        error = model.reduced(x, q)
        count = len(x)
        return error.residual.reshape(count, -1), error.jac_x.reshape(count, -1, len(parameters))

    angles = [k for k, p in enumerate(parameters) if p.is_angle]
    return _minima(*_minimised(problem, x0, progress), angles=angles)


def _minima(
    x: FloatArray, cost: FloatArray, *, angles: Sequence[int]
) -> list[tuple[FloatArray, int]]:
    """The best minima, in order of increasing cost, with the number of starts that reached each."""
    order = np.argsort(cost, kind="stable")
    minima: list[tuple[FloatArray, int]] = []
    while len(order) and len(minima) < REFINED_MINIMA:
        apart = wrap_angle(x[order][:, angles] - x[order[0], angles])
        same = np.abs(apart).max(-1, initial=0.0) < SAME_MINIMUM
        minima.append((x[order[0]], int(same.sum())))
        order = order[~same]
    return minima


def _minimised(
    problem: BatchProblem, x0: FloatArray, progress: Progress | None
) -> tuple[FloatArray, FloatArray]:
    """Minimise the sum of squares from every row of `x0` (S, K); return the last unknowns (S, K) and sums (S,).

    After `HALT_AFTER` iterations only the starts of least cost continue; the starts that would reach the solution are
    nearly always among them.
    """
    survivors = max(FEWEST_SURVIVORS, int(SURVIVING_SHARE * len(x0)))
    x = np.array(x0, dtype=np.float64)
    r, J = problem(x)
    cost = np.einsum("sr,sr->s", r, r)
    damping = np.full(len(x), FIRST_DAMPING)
    active = np.arange(len(x))
    for iteration in range(1, BATCH_ITERATIONS + 1):
        Jt = np.swapaxes(J, -1, -2)
        N, gradient = Jt @ J, (Jt @ r[..., None])[..., 0]
        diagonal = np.diagonal(N, axis1=-2, axis2=-1)
        # Marquardt's scaling; a column of zeros needs a divisor too.
        tiny = 1e-12 * diagonal.max(-1, keepdims=True) + 1e-300
        N = N + (damping[active, None] * diagonal + tiny)[..., None] * np.eye(x.shape[1])
        step = -np.linalg.solve(N, gradient[..., None])[..., 0]
        longest = np.abs(step).max(-1)
        step *= np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(longest, 1e-300))[:, None]
        trial = x[active] + step
        r_new, J_new = problem(trial)
        cost_new = np.einsum("sr,sr->s", r_new, r_new)
        better = cost_new < cost[active]
        x[active[better]], cost[active[better]] = trial[better], cost_new[better]
        r, J = (
            np.where(better[:, None], r_new, r),
            np.where(better[:, None, None], J_new, J),
        )
        damping[active] *= np.where(better, EASIER, HARDER)
        if progress is not None:
            progress(iteration, float(cost.min()))
        going = (longest > STEP_TOLERANCE) & (damping[active] < STUCK_DAMPING)
        if iteration == HALT_AFTER:
            going &= np.isin(active, np.argsort(cost, kind="stable")[:survivors])
        active, r, J = active[going], r[going], J[going]
        if not len(active):
            break
    return x, cost

"""The batch of starts of a global start: which unknowns are guessed, and their damped Gauss-Newton iteration.

Every start has its own damping; starts that have converged leave the batch. `global_start` refines the results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.parameters import nominal_vector, wrap_angle
from solver.estimators.least_squares import Progress
from solver.loops.closure import ClosureModel
from solver.search.inner import InnerProblem, projectable_parts, spread_poses

HALT_AFTER = 8
SURVIVING_SHARE, FEWEST_SURVIVORS = 1.0 / 3.0, 30
"""After a few steps only the best third continues. It has 80 to 100 % of the starts that would have reached the
solution (random hinges, a ball), so for the same work twice as many do."""

SEARCH_EQUATIONS = 72
"""Closure equations in the search: a few times the unknowns of any usual arm."""

REFINED_MINIMA = 6
"""Minima that are refined: the cost of the true one is orders below the next, so it is among the first."""

SAME_MINIMUM = 0.02
"""Starts that end within this distance of each other (rad) count as one minimum."""


class StartSearch:
    """Result of minimising from all starts.

    `poses`: number of poses the search used.
    """

    def __init__(
        self,
        model: ClosureModel,
        q: FloatArray,
        starts: int,
        rng: np.random.Generator,
        progress: Progress | None,
    ) -> None:
        self.model, self.q = model, q
        self.parts = projectable_parts(model, q)
        self._progress = progress
        self._nominal = nominal_vector(model.parameters)
        if self.parts and self.parts[0].problem.searched:
            # The largest placement finds the arm's offsets; the others only their own fixtures.
            largest = max(self.parts, key=lambda part: len(part.q)).problem
            count = -(-SEARCH_EQUATIONS // model.equations_per_pose)
            few = spread_poses(largest.q, count)
            self.poses = len(few)
            searched = InnerProblem(
                table=largest.table,
                searched=largest.searched,
                constrained_part=largest.constrained_part,
                q=few,
                per_m=largest.per_m,
            )
            here = np.array([largest.table.theta_off_rad[j - 1] for j in largest.searched])
            x0 = np.concatenate(
                (here[None, :], rng.uniform(-np.pi, np.pi, (starts - 1, len(here))))
            )
            self.fit = self._minimised(searched, x0)
        else:
            self.poses = len(q)
            self.fit = self._blind(starts, rng)

    def candidates(self) -> list[tuple[FloatArray, int]]:
        """Complete parameter vectors (P,) of the best minima, with the number of starts that ended there."""
        return [
            (self._whole(self.fit.x[members[0]]), len(members))
            for members in _minima(self.fit, self._angles())[:REFINED_MINIMA]
        ]

    def _angles(self) -> list[int]:
        if self.parts and self.parts[0].problem.searched:
            return list(range(self.fit.x.shape[1]))
        return [k for k, p in enumerate(self.model.parameters) if p.is_angle]

    def _whole(self, guess: FloatArray) -> FloatArray:
        if not (self.parts and self.parts[0].problem.searched):
            return guess
        x = self._nominal.copy()
        for part in self.parts:
            x[part.columns] = part.filled(guess)
        return x

    def _blind(self, starts: int, rng: np.random.Generator) -> BatchFit:
        """Search over all unknowns, for models whose fixture cannot be projected out."""
        parameters = self.model.parameters
        turned = [k for k, p in enumerate(parameters) if p.name.startswith("theta_off_")]
        x0 = np.tile(self._nominal, (starts, 1))
        x0[1:, turned] = rng.uniform(-np.pi, np.pi, (starts - 1, len(turned)))

        def problem(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            error = self.model.reduced(x, self.q)
            count = len(x)
            return (
                error.residual.reshape(count, -1),
                error.jac_x.reshape(count, -1, len(parameters)),
            )

        return self._minimised(problem, x0)

    def _minimised(self, problem: BatchProblem, x0: FloatArray) -> BatchFit:
        return minimise_batch(
            problem,
            x0,
            halt_after=HALT_AFTER,
            survivors=max(FEWEST_SURVIVORS, int(SURVIVING_SHARE * len(x0))),
            progress=self._progress,
        )


def _minima(fit: BatchFit, angles: list[int]) -> list[IntArray]:
    """Starts that reached each minimum, by rising cost; the first is the best."""
    left = np.argsort(fit.cost, kind="stable")
    found = []
    while len(left):
        apart = wrap_angle(fit.x[left][:, angles] - fit.x[left[0], angles])
        same = np.abs(apart).max(-1, initial=0.0) < SAME_MINIMUM
        found.append(left[same])
        left = left[~same]
    return found


BatchProblem = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function from unknowns (S, K) to residuals (S, R) and Jacobian (S, R, K)."""

FIRST_DAMPING = 1e-2
EASIER, HARDER = 0.2, 5.0
STUCK_DAMPING = 1e7
STEP_TOLERANCE = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchFit:
    """End of each start: unknowns (S, K) and sum of squared residuals (S,)."""

    x: FloatArray
    cost: FloatArray


BATCH_ITERATIONS, LONGEST_STEP_RAD = 40, 0.7
"""Most iterations, and the longest component of one step: beyond it a linearised rotation is invalid."""


def minimise_batch(
    problem: BatchProblem,
    x0: FloatArray,
    *,
    halt_after: int | None = None,
    survivors: int = 0,
    progress: Progress | None = None,
) -> BatchFit:
    """Minimise the sum of squares from every row of `x0` (S, K).

    `halt_after`, `survivors`: after this many iterations only this many of the starts continue, those of least cost;
    the others stop. Starts that will reach the solution nearly always have the least cost by then.
    """
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
        if iteration == halt_after:
            going &= np.isin(active, np.argsort(cost, kind="stable")[:survivors])
        active, r, J = active[going], r[going], J[going]
        if not len(active):
            break
    return BatchFit(x=x, cost=cost)

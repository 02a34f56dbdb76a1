"""The batch of starts: which unknowns are guessed, and how a guess becomes a whole parameter vector.

Knows loops; polishes and judges nothing (`global_start` does).
"""

from __future__ import annotations

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.parameters import nominal_vector, wrap_angle
from solver.estimators.least_squares import Progress
from solver.loops.closure import ClosureModel
from solver.search.batched_least_squares import BatchFit, BatchProblem, minimise_batch
from solver.search.inner import InnerProblem, spread_poses
from solver.search.inner_parts import projectable_parts

HALT_AFTER = 8
SURVIVING_SHARE, FEWEST_SURVIVORS = 1.0 / 3.0, 30
"""After a few steps the best third goes on. Of the starts that would have arrived, 80 to 100 % are among
them (wild hinges, a ball), so that for the same work twice as many arrive."""

SEARCH_EQUATIONS = 72
"""Closure equations the search works on: a few times the unknowns of any usual arm."""

POLISHED = 6
"""Basins that are polished: the true one's cost is orders below the next, so it is among the first."""

SAME_BASIN = 0.02
"""Starts that end within this of each other (rad) ended in one basin."""


class StartSearch:
    """Starts that have come down.

    Attributes
    ----------
    poses
        Number of poses the search used.
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
                hold=largest.hold,
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
        """Whole starts (P,) of the best basins with the number of starts that ended there."""
        return [
            (self._whole(self.fit.x[members[0]]), len(members))
            for members in _basins(self.fit, self._angles())[:POLISHED]
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
        """Search over everything, for models whose fixture cannot be projected out."""
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


def _basins(fit: BatchFit, angles: list[int]) -> list[IntArray]:
    """Members of each basin, by rising cost; the first member of each is its best."""
    left = np.argsort(fit.cost, kind="stable")
    found = []
    while len(left):
        apart = wrap_angle(fit.x[left][:, angles] - fit.x[left[0], angles])
        same = np.abs(apart).max(-1, initial=0.0) < SAME_BASIN
        found.append(left[same])
        left = left[~same]
    return found

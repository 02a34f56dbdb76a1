"""Calibration from nothing: offsets anywhere in +-180 deg, the fixture unknown. Knows loops, no noise model.

Many starts go down in one batch on a few poses that spread; where the fixture can be projected out
(`inner_search`) only the inner joints' offsets are guessed. The best basins are then polished with all
unknowns on all poses, and judged there: how many starts led to the best, whether another loop, not
merely another description of the same one, fits as well. Deterministic for a seed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.batched_least_squares import BatchFit, BatchProblem, minimise_batch
from solver.closure import ClosureModel, nearest_equivalent
from solver.estimate import require_enough_poses
from solver.inner_parts import projectable_parts
from solver.inner_search import InnerProblem, spread_poses
from solver.least_squares import Progress, solve_damped
from solver.parameters import nominal_vector, wrap_angle, wrap_angles

STARTS = 500
STARTS_WITHOUT_DIRECTION = 1500
"""Default numbers of starts. Where the hand's direction is held too (hinge, rigid), 4 to 40 % of the starts
arrive; of a ball's, on joints that moved little, 1 %."""

HALT_AFTER = 8
SURVIVING_SHARE, FEWEST_SURVIVORS = 1.0 / 3.0, 30
"""After a few steps the best third goes on. Of the starts that would have arrived, 80 to 100 % are among
them (wild hinges, a ball), so that for the same work twice as many arrive."""

SEARCH_EQUATIONS = 72
"""Closure equations the search works on: a few times the unknowns of any usual arm."""

POLISHED = 6
"""Basins that are polished: the true one's cost is orders below the next, so it is among the first."""

FIRST_POLISH = 12
HOPELESS = 100.0
"""A basin whose cost is this many times the best after the first polish is not polished further: no
rival comes from ten times the rms closure. Its `rms` is then an upper bound."""

SAME_BASIN = 0.02
"""Starts that end within this of each other (rad) ended in one basin."""

SAME_LOOP = 1e-4
"""Polished parameters that differ by less than this (rad, m) are one solution."""

FITS_AS_WELL = 1.5
"""A solution whose rms closure is within this factor of the best cannot be told from it: with 200
degrees of freedom noise alone makes a factor of 1.2 a 1 % event, and systematic errors make more."""

CLOSED = 1e-9
"""An rms closure below this is closed, whatever the ratio."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Basin:
    """One solution of the search.

    Attributes
    ----------
    x
        Parameters (P,) in the description nearest to the nominal one.
    rms
        Root mean square of the reduced closure error over all poses (1 m : 1 rad).
    starts
        How many starts ended here.
    flipped
        Poses (indices) that this solution puts on the flipped branch: it is no solution then.
    """

    x: FloatArray
    rms: float
    starts: int
    flipped: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalStart:
    """What the search found.

    Attributes
    ----------
    basins
        Distinct solutions, the best first, none on the flipped branch unless all are.
    starts
        Number of starts.
    search_poses
        Number of poses the search itself used.
    """

    basins: tuple[Basin, ...]
    starts: int
    search_poses: int

    @property
    def best(self) -> Basin:
        """The best solution: where an estimator should start."""
        return self.basins[0]

    @property
    def x(self) -> FloatArray:
        """Parameters (P,) of the best solution."""
        return self.best.x

    @property
    def rivals(self) -> tuple[Basin, ...]:
        """Distinct solutions that fit as well: the poses cannot decide between them."""
        bound = max(FITS_AS_WELL * self.best.rms, CLOSED)
        return tuple(b for b in self.basins[1:] if b.rms <= bound and not b.flipped)


def global_start(
    model: ClosureModel,
    q: FloatArray,
    *,
    starts: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> GlobalStart:
    """Search for parameters of `model` that close the poses `q` (m, n), rad, from everywhere.

    Parameters
    ----------
    starts
        Number of starts; the first is the nominal one, the rest are random. By default enough for
        the kind of fixture.
    seed
        Of the random starts: the same seed gives the same result.
    progress
        Called after each iteration of the search; may raise to cancel.

    Raises
    ------
    TooFewPosesError
        No degree of freedom would be left.
    ValueError
        If there is no start to go from.
    """
    if starts is not None and starts < 1:
        raise ValueError("at least one start is needed")
    sensed = model.with_all_joints_sensed()
    require_enough_poses(sensed, len(q))
    if starts is None:
        directed = sensed.equations_per_pose > 3
        starts = STARTS if directed else STARTS_WITHOUT_DIRECTION
    rng = np.random.default_rng(seed)
    search = _Search(sensed, q, starts, rng, progress)
    nominal = nominal_vector(sensed.parameters)
    names = [p.name for p in sensed.parameters]
    here = [names.index(p.name) for p in model.parameters]

    def problem(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        error = sensed.reduced(x, q)
        return error.residual.reshape(-1), error.jac_x.reshape(-1, len(nominal))

    found: list[tuple[FloatArray, Basin]] = []
    best = np.inf
    for x0, count in search.candidates():
        fit = solve_damped(problem, x0, max_iterations=FIRST_POLISH)
        if not fit.converged and fit.cost < HOPELESS * max(best, 0.5 * q.size * CLOSED**2):
            fit = solve_damped(problem, fit.x)
        best = min(best, fit.cost)
        x = nearest_equivalent(sensed, fit.x, nominal)
        error = sensed.reduced(x, q)
        basin = Basin(
            x=x[here],
            rms=float(np.sqrt(np.mean(error.residual**2))),
            starts=count,
            flipped=tuple(int(k) for k in np.flatnonzero(error.flipped)),
        )
        for k, (other, known) in enumerate(found):
            if _same_loop(sensed, x, other):
                better = min(basin, known, key=lambda b: b.rms)
                merged = Basin(
                    x=better.x,
                    rms=better.rms,
                    starts=known.starts + count,
                    flipped=better.flipped,
                )
                found[k] = (x if better is basin else other, merged)
                break
        else:
            found.append((x, basin))
    basins = sorted((b for _, b in found), key=lambda b: (bool(b.flipped), b.rms))
    return GlobalStart(basins=tuple(basins), starts=starts, search_poses=search.poses)


def _same_loop(model: ClosureModel, x: FloatArray, other: FloatArray) -> bool:
    near = nearest_equivalent(model, x, other)
    return bool(np.abs(wrap_angles(model.parameters, near - other)).max(initial=0.0) < SAME_LOOP)


class _Search:
    """The batch: which unknowns are guessed, and how a guess becomes a whole parameter vector."""

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

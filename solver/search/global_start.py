"""Calibration from nothing: offsets anywhere in +-180 deg, the fixture unknown.

Many starts go down in one batch on a few poses that spread; where the fixture can be projected out
(`inner_search`) only the inner joints' offsets are guessed. The best basins are then polished with all
unknowns on all poses, and judged there: how many starts led to the best, whether another loop, not
merely another description of the same one, fits as well. Deterministic for a seed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.estimators.estimate import require_enough_poses
from solver.estimators.least_squares import Progress, solve_damped
from solver.estimators.paper import ClosureProblem
from solver.loops.closure import ClosureModel, nearest_equivalent
from solver.search.starts import StartSearch

STARTS = 500
STARTS_WITHOUT_DIRECTION = 1500
"""Default numbers of starts. Where the hand's direction is held too (hinge, rigid), 4 to 40 % of the starts
arrive; of a ball's, on joints that moved little, 1 %."""

FIRST_POLISH = 12
HOPELESS = 100.0
"""A basin whose cost is this many times the best after the first polish is not polished further: no
rival comes from ten times the rms closure. Its `rms` is then an upper bound."""

MIXED = 0.03
"""An rms closure (1 m : 1 rad) that no real arm leaves: poses of both branches may be mixed."""

HINGE_EQUATIONS = 5
SAMPLES = 8
SAMPLE_POSES = 8
NEAR_M, NEAR_RAD = 0.1, 0.3
EXPLAINED = 0.9

SAME_LOOP = 1e-4
"""Polished parameters that differ by less than this (rad, m) are one solution."""

FITS_AS_WELL = 1.5
"""A solution whose rms closure is within this factor of the best cannot be told from it: with 200
degrees of freedom noise alone makes a factor of 1.2 a 1 % event, and systematic errors make more."""

CLOSED = 1e-9
"""An rms closure below this is closed, whatever the ratio."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalMinimum:
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
    set_aside
        Poses (indices) taken with the hand the other way round on the hinge: no part of any solution.
        `LocalMinimum.flipped` counts among the others.
    """

    minima: tuple[LocalMinimum, ...]
    starts: int
    search_poses: int
    set_aside: tuple[int, ...] = ()

    @property
    def best(self) -> LocalMinimum:
        """The best solution: where an estimator should start."""
        return self.minima[0]

    @property
    def x(self) -> FloatArray:
        """Parameters (P,) of the best solution."""
        return self.best.x

    @property
    def alternatives(self) -> tuple[LocalMinimum, ...]:
        """Distinct solutions that fit as well: the poses cannot decide between them."""
        bound = max(FITS_AS_WELL * self.best.rms, CLOSED)
        return tuple(b for b in self.minima[1:] if b.rms <= bound and not b.flipped)


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
    found = _solve(model, sensed, q, starts, rng, progress)
    if found.best.rms > MIXED and sensed.equations_per_pose == HINGE_EQUATIONS:
        upright = _upright(sensed, q, starts, rng, progress)
        if not upright.all():
            kept = np.flatnonzero(upright)
            alone = _solve(
                model.at_poses(kept), sensed.at_poses(kept), q[kept], starts, rng, progress
            )
            if alone.best.rms < found.best.rms:
                aside = tuple(int(k) for k in np.flatnonzero(~upright))
                return replace(alone, set_aside=aside)
    return found


def _solve(
    model: ClosureModel,
    sensed: ClosureModel,
    q: FloatArray,
    starts: int,
    rng: np.random.Generator,
    progress: Progress | None,
) -> GlobalStart:
    """Search, polish on all of `q`, and tell solutions apart."""
    search = StartSearch(sensed, q, starts, rng, progress)
    nominal = nominal_vector(sensed.parameters)
    names = [p.name for p in sensed.parameters]
    here = [names.index(p.name) for p in model.parameters]
    problem = ClosureProblem.of(sensed, q)

    found: list[tuple[FloatArray, LocalMinimum]] = []
    best = np.inf
    for x0, count in search.candidates():
        fit = solve_damped(problem, x0, max_iterations=FIRST_POLISH)
        if not fit.converged and fit.cost < HOPELESS * max(best, 0.5 * q.size * CLOSED**2):
            fit = solve_damped(problem, fit.x)
        best = min(best, fit.cost)
        x = nearest_equivalent(sensed, fit.x, nominal)
        error = sensed.reduced(x, q)
        minimum = LocalMinimum(
            x=x[here],
            rms=float(np.sqrt(np.mean(error.residual**2))),
            starts=count,
            flipped=tuple(int(k) for k in np.flatnonzero(error.flipped)),
        )
        for k, (other, known) in enumerate(found):
            if _same_loop(sensed, x, other):
                better = min(minimum, known, key=lambda b: b.rms)
                merged = LocalMinimum(
                    x=better.x,
                    rms=better.rms,
                    starts=known.starts + count,
                    flipped=better.flipped,
                )
                found[k] = (x if better is minimum else other, merged)
                break
        else:
            found.append((x, minimum))
    minima = sorted((b for _, b in found), key=lambda b: (bool(b.flipped), b.rms))
    return GlobalStart(minima=tuple(minima), starts=starts, search_poses=search.poses)


def _upright(
    model: ClosureModel,
    q: FloatArray,
    starts: int,
    rng: np.random.Generator,
    progress: Progress | None,
) -> BoolArray:
    """Poses on the branch that most are on (m,), found from few poses at a time.

    A few poses taken with the hand the other way round spoil a fit of all. Some small sample has none of
    them; its loop closes on the poses of its own branch and is upside down on the rest.
    """
    best = np.ones(len(q), dtype=np.bool_)
    score = (0, -np.inf)
    for _ in range(SAMPLES):
        few = np.sort(rng.choice(len(q), min(SAMPLE_POSES, len(q)), replace=False))
        search = StartSearch(model.at_poses(few), q[few], starts, rng, progress)
        error = model.reduced(search.candidates()[0][0], q)
        near = np.linalg.norm(error.residual[:, error.rotation_rows :], axis=-1) < NEAR_M
        swing = np.linalg.norm(error.residual[:, : error.rotation_rows], axis=-1)
        upright, over = near & (swing < NEAR_RAD), near & (swing > np.pi - NEAR_RAD)
        # A sample without strangers explains nearly every pose, one way or the other, and exactly.
        explained = upright | over
        here = (int(explained.sum()), -float(np.median(np.linalg.norm(error.residual, axis=-1))))
        if here[0] >= EXPLAINED * len(q) and upright.sum() > over.sum() and here > score:
            best, score = ~over, here
    return best


def _same_loop(model: ClosureModel, x: FloatArray, other: FloatArray) -> bool:
    near = nearest_equivalent(model, x, other)
    return bool(np.abs(wrap_angles(model.parameters, near - other)).max(initial=0.0) < SAME_LOOP)

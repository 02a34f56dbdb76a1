"""Calibration without a first guess: offsets anywhere in +-180 deg, the fixture unknown.

Many starts are minimised in one batch (`solver.search.starts`). If the fixture's unknowns follow from the others in
closed form, only the offsets of joints 2 .. n-1 are guessed, and a few poses far apart suffice. The best minima are
then refined with all unknowns and all poses. The result states how many starts led to each minimum.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.estimators.estimate import require_enough_poses
from solver.estimators.least_squares import Progress, solve_damped
from solver.estimators.paper import closure_problem
from solver.loops.closure import ClosureModel, in_order, nearest_equivalent
from solver.search.starts import best_minima

STARTS = 500
STARTS_WITHOUT_DIRECTION = 1500
"""Default numbers of starts: STARTS if the fixture also constrains the tool's direction (hinge, rigid), where 4 to 40 %
of the starts reach the solution; otherwise STARTS_WITHOUT_DIRECTION, because with a ball and little motion of the
joints only 1 % do."""

FIRST_POLISH = 12
REFINED_COST_RATIO = 100.0
"""A minimum whose cost after the first refinement is more than this many times the best cost, i.e. whose rms closure is
ten times the best, is no alternative solution. It is not refined further, so that its `rms` is an upper bound."""

BRANCHES_MIXED_RMS = 0.03
"""The rms closure error (1 m as 1 rad) of real arms is smaller than this. If it is larger, the pose set may contain
poses of both branches."""

HINGE_EQUATIONS = 5
SAMPLES = 8
SAMPLE_POSES = 8
NEAR_M, NEAR_RAD = 0.1, 0.3
EXPLAINED = 0.9

SAME_SOLUTION = 1e-4
"""Refined parameters that differ by less than this (rad, m) count as one solution."""

EQUAL_FIT_RATIO = 1.5
"""A solution whose rms closure is within this factor of the best is indistinguishable from it: with 200 degrees of
freedom noise alone causes a factor of 1.2 in 1 % of cases, and systematic errors cause more."""

CLOSED = 1e-9
"""An rms closure below this counts as closed, whatever the ratio."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalMinimum:
    """One solution of the search.

    `x`: parameters (P,), the nearest to the nominal values among equivalent vectors. `rms`: root mean square of the
    reduced closure error over all poses; 1 m counts as 1 rad. `starts`: number of starts that ended here. `flipped`:
    indices of poses on the flipped branch of this solution; a solution with such poses is invalid.
    """

    x: FloatArray
    rms: float
    starts: int
    flipped: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalStart:
    """Result of a search from `starts` starts.

    `minima`: distinct solutions, the best first; solutions with poses on the flipped branch come last. `set_aside`:
    indices of poses left out of the search because the tool was upside down on the hinge. The indices in
    `LocalMinimum.flipped` refer to the remaining poses.
    """

    minima: tuple[LocalMinimum, ...]
    starts: int
    set_aside: tuple[int, ...] = ()

    @property
    def best(self) -> LocalMinimum:
        """The best solution, as a start for an estimator."""
        return self.minima[0]

    @property
    def x(self) -> FloatArray:
        """Parameters (P,) of the best solution."""
        return self.best.x

    @property
    def alternatives(self) -> tuple[LocalMinimum, ...]:
        """Other solutions that fit as well as the best: the poses cannot decide between them and the best."""
        bound = max(EQUAL_FIT_RATIO * self.best.rms, CLOSED)
        return tuple(b for b in self.minima[1:] if b.rms <= bound and not b.flipped)


def global_start(
    model: ClosureModel,
    q: FloatArray,
    *,
    starts: int | None = None,
    progress: Progress | None = None,
) -> GlobalStart:
    """Search for parameters of `model` that close the poses `q` (m, n), rad, without a first guess.

    `starts`: number of starts (default: 500, or 1500 if only positions are constrained). The first has the nominal
    values, the others random offsets; they are the same in every call. `progress`: called after each iteration of the
    search; may raise to cancel. Raises `TooFewPosesError` if the poses do not give more equations than unknowns.
    """
    sensed = model.with_all_joints_sensed()
    require_enough_poses(sensed, len(q))
    if starts is None:
        starts = STARTS if sensed.equations_per_pose > 3 else STARTS_WITHOUT_DIRECTION
    rng = np.random.default_rng(0)
    search: Search = partial(best_minima, starts=starts, rng=rng, progress=progress)
    start = GlobalStart(minima=_solve(model, sensed, q, search), starts=starts)
    if start.best.rms > BRANCHES_MIXED_RMS and sensed.equations_per_pose == HINGE_EQUATIONS:
        upright = _main_branch(sensed, q, search, rng)
        if not upright.all():
            kept = np.flatnonzero(upright)
            minima = _solve(model.at_poses(kept), sensed.at_poses(kept), q[kept], search)
            if minima[0].rms < start.best.rms:
                aside = tuple(np.flatnonzero(~upright).tolist())
                return GlobalStart(minima=minima, starts=starts, set_aside=aside)
    return start


Search = Callable[[ClosureModel, FloatArray], list[tuple[FloatArray, int]]]
"""Function from a model and its poses (m, n) to the best minima: `best_minima` with all other arguments bound."""


def _solve(
    model: ClosureModel, sensed: ClosureModel, q: FloatArray, search: Search
) -> tuple[LocalMinimum, ...]:
    """Search, refine the minima on all poses `q`, and return the distinct solutions, the best first."""
    nominal = nominal_vector(sensed.parameters)
    problem = closure_problem(sensed, q)

    solutions: list[tuple[FloatArray, LocalMinimum]] = []
    best = np.inf
    for x0, count in search(sensed, q):
        fit = solve_damped(problem, x0, max_iterations=FIRST_POLISH)
        worth_refining = REFINED_COST_RATIO * max(best, 0.5 * q.size * CLOSED**2)
        if not fit.converged and fit.cost < worth_refining:
            fit = solve_damped(problem, fit.x)
        best = min(best, fit.cost)
        x = nearest_equivalent(sensed, fit.x, nominal)
        error = sensed.reduced(x, q)
        minimum = LocalMinimum(
            x=in_order(model, sensed, x),
            rms=float(np.sqrt(np.mean(error.residual**2))),
            starts=count,
            flipped=error.flipped_poses,
        )
        for k, (other, known) in enumerate(solutions):
            apart = wrap_angles(sensed.parameters, nearest_equivalent(sensed, x, other) - other)
            if np.abs(apart).max(initial=0.0) < SAME_SOLUTION:
                better = min(minimum, known, key=lambda b: b.rms)
                merged = replace(better, starts=known.starts + count)
                solutions[k] = (x if better is minimum else other, merged)
                break
        else:
            solutions.append((x, minimum))
    return tuple(sorted((b for _, b in solutions), key=lambda b: (bool(b.flipped), b.rms)))


def _main_branch(
    model: ClosureModel, q: FloatArray, search: Search, rng: np.random.Generator
) -> BoolArray:
    """Return whether each pose (m,) is on the same branch as most poses, from fits to small samples of the poses.

    A few poses taken with the tool upside down spoil a fit of all poses, but a small sample may contain none of them. A
    loop fitted to such a sample closes at all upright poses; at the others, its rotation error is near pi.
    """
    best = np.ones(len(q), dtype=np.bool_)
    score = (0, -np.inf)
    for _ in range(SAMPLES):
        few = np.sort(rng.choice(len(q), min(SAMPLE_POSES, len(q)), replace=False))
        (x, _), *_ = search(model.at_poses(few), q[few])
        error = model.reduced(x, q)
        near = np.linalg.norm(error.residual[:, error.rotation_rows :], axis=-1) < NEAR_M
        swing = np.linalg.norm(error.residual[:, : error.rotation_rows], axis=-1)
        upright, over = near & (swing < NEAR_RAD), near & (swing > np.pi - NEAR_RAD)
        # A fit to poses of one branch explains nearly every pose, on either branch.
        explained = upright | over
        quality = (int(explained.sum()), -float(np.median(np.linalg.norm(error.residual, axis=-1))))
        if quality[0] >= EXPLAINED * len(q) and upright.sum() > over.sum() and quality > score:
            best, score = ~over, quality
    return best

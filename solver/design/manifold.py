"""The self-motion manifold inside joint ranges: closed poses that cover it, and pairs of neighbours.

The closed chain moves on a manifold whose dimension is the chain's mobility (two with a hinge). Poses are added in
waves from the current pose: each new pose takes tangent steps, all steps of a wave are closed in one batch, and poses
too near to an older pose are dropped. The poses cover the part reachable inside the ranges, at nearly even spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray
from solver.closing import close_loops
from solver.design.motion import ChainMotion, Ranges, chain_motion
from solver.loops.closure import ClosureModel

SPACING = 0.75
"""New poses are at least this share of a step from all others; a disc packing at this distance leaves few gaps."""
INNER_RING_SHARE = 0.8
"""Length of the tangent steps of the second ring, as a share of a step; just longer than the spacing."""
NEIGHBOUR_STEPS = 1.7
"""Poses within this many steps are neighbours: this includes the six around a pose, but not the next ring."""
MOST_BEND_SHARE = 0.35
"""A neighbour farther from the tangent plane than this share of its distance is on another sheet."""
LEAST_SPACING_SHARE = 0.2
"""The end of a tangent step is dropped before closing if an earlier end is nearer than this share of a step."""
COARSE_STEP_RAD = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifold:
    """Closed poses of the loop `model` that cover the region reachable from pose 0 inside the ranges.

    `x` (P,): parameters of the loop. `q`, `u`: joint angles (m, n) and unsensed angles (m, U), rad; pose 0 is the
    start. `motion`: tangents at all poses. `neighbours` (E, 2): pairs of neighbouring poses, lower index first, sorted.
    """

    model: ClosureModel
    x: FloatArray
    q: FloatArray
    u: FloatArray
    motion: ChainMotion
    neighbours: IntArray

    @property
    def size(self) -> int:
        """Number m of poses."""
        return len(self.q)


def grow_manifold(
    model: ClosureModel,
    x: FloatArray,
    q_start: FloatArray,
    ranges: Ranges,
    *,
    step_rad: float = 0.12,
    most: int = 8000,
    seed: int = 0,
) -> Manifold:
    """Cover the manifold of the closed poses that are reachable from the closed pose nearest to `q_start` (n,), rad.

    Raises `ValueError` if no closed pose is found near the start.
    `x` (P,): parameters of the loop. `ranges`: all poses lie inside, except possibly the start. `step_rad`: length of a
    tangent step. `most`: largest number of poses. `seed`: seed of the random directions.
    """
    start = close_loops(model, x, np.asarray(q_start, dtype=np.float64)[None, :])
    if not bool(start.closed[0]):
        raise ValueError("the loop does not close near the start pose with these parameters")
    rng = np.random.default_rng(seed)
    n = len(ranges.lower_rad)
    points = front = np.concatenate((start.q, start.u), axis=-1)
    while len(front) and len(points) < most:
        tangent = chain_motion(model, x, front[:, :n], front[:, n:]).tangent
        # Spacing is measured in the joint angles; on a one-dimensional manifold, in all angles.
        own = slice(n if tangent.shape[-1] > 1 else None)
        wave = _wave(front, tangent, step_rad, rng)
        wave = wave[ranges.clearance(wave[:, :n]) > -step_rad]
        wave = wave[_far_from(points[:, own], wave[:, own], 0.6 * step_rad)]
        # Steps that nearly repeat another one are dropped before they are closed.
        wave = wave[_spread(wave[:, own], LEAST_SPACING_SHARE * step_rad)]
        if len(wave) == 0:
            break
        closed = close_loops(
            model, x, wave[:, :n], u=wave[:, n:], max_iterations=6, tolerance=1e-11
        )
        # A correction as long as the step itself has reached another sheet.
        distance = np.sqrt(((closed.q - wave[:, :n]) ** 2).sum(-1))
        keep = closed.closed & (ranges.clearance(closed.q) >= 0.0) & (distance < 0.7 * step_rad)
        wave = np.concatenate((closed.q, closed.u), axis=-1)[keep]
        wave = wave[_far_from(points[:, own], wave[:, own], SPACING * step_rad)]
        front = wave[_spread(wave[:, own], SPACING * step_rad)][: most - len(points)]
        points = np.concatenate((points, front))
    q, u = points[:, :n].copy(), points[:, n:].copy()
    motion = chain_motion(model, x, q, u)
    neighbours = _neighbours(points, motion, step_rad)
    return Manifold(model=model, x=np.array(x), q=q, u=u, motion=motion, neighbours=neighbours)


def candidate_poses(
    model: ClosureModel,
    x: FloatArray,
    q_start: FloatArray,
    ranges: Ranges,
    *,
    count: int,
    seed: int = 0,
) -> Manifold:
    """Cover the manifold reachable from `q_start` with about `count` poses, whatever the manifold's size.

    A coarse pass measures the manifold's size, which determines the step of the fine pass.
    """
    first = COARSE_STEP_RAD if count > 1000 else 2.0 * COARSE_STEP_RAD
    coarse = grow_manifold(model, x, q_start, ranges, step_rad=first, most=4 * count, seed=seed)
    step = first * (coarse.size / count) ** (1.0 / coarse.motion.degrees)
    step = float(np.clip(step, 0.01, 2.0 * COARSE_STEP_RAD))
    return grow_manifold(model, x, q_start, ranges, step_rad=step, most=2 * count, seed=seed)


def _wave(
    points: FloatArray, tangent: FloatArray, step_rad: float, rng: np.random.Generator
) -> FloatArray:
    """Take tangent steps in several directions from each of the `points`; return the ends (k, n + U), rad."""
    poses, angles, degrees = tangent.shape
    if degrees == 1:
        directions = np.broadcast_to([[[1.0], [-1.0]]], (poses, 2, 1))
    elif degrees == 2:
        # Twelve directions from a random phase, so that rows do not line up.
        # A second ring of shorter steps, in directions between these, finds the way through necks narrower than a step.
        turn = np.arange(12) * (np.pi / 6.0)
        turns = np.concatenate((turn, turn + np.pi / 12.0))
        angle = rng.uniform(0.0, np.pi / 3.0, (poses, 1)) + turns
        length = np.repeat([1.0, INNER_RING_SHARE], 12)[:, None]
        directions = length * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    else:
        directions = rng.normal(size=(poses, 3 * degrees, degrees))
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    steps = step_rad * (directions @ np.swapaxes(tangent, -1, -2))
    return (points[:, None, :] + steps).reshape(-1, angles)


def _far_from(others: FloatArray, points: FloatArray, distance: float) -> BoolArray:
    """Whether each of `points` (m, d) is at least `distance`, rad, from all of `others` (k, d); shape (m,)."""
    from scipy.spatial import cKDTree  # takes long to import; the terminal app may never need it

    nearest, _ = cKDTree(others).query(points, distance_upper_bound=distance)
    return np.asarray(nearest >= distance)


def _pairs(points: FloatArray, distance: float) -> IntArray:
    """Return the sorted index pairs (E, 2), lower index first, of points within `distance` of each other."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))], dtype=np.int64)


def _spread(points: FloatArray, distance: float) -> IntArray:
    """Return the indices of the points that are kept, in order; a point within `distance` of a kept one is dropped."""
    dropped = np.zeros(len(points), dtype=np.bool_)
    for first, second in _pairs(points, distance):
        if not dropped[first]:
            dropped[second] = True
    return np.flatnonzero(~dropped)


def _neighbours(points: FloatArray, motion: ChainMotion, step_rad: float) -> IntArray:
    """Return the index pairs (E, 2) of poses that are neighbours along the manifold."""
    pairs = _pairs(points, NEIGHBOUR_STEPS * step_rad)
    apart = points[pairs[:, 1]] - points[pairs[:, 0]]
    length = np.linalg.norm(apart, axis=-1)
    flat = np.ones(len(pairs), dtype=np.bool_)
    for end in (0, 1):
        T = motion.tangent[pairs[:, end]]
        along = (np.swapaxes(T, -1, -2) @ apart[..., None])[..., 0]
        offset = np.sqrt(np.maximum(length**2 - (along**2).sum(-1), 0.0))
        flat &= offset <= MOST_BEND_SHARE * length
    return pairs[flat]

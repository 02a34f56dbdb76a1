"""Which joints should drive a closed chain: ranking of the possible sets of drive joints.

At one pose, sets are ranked by the leverage of the drives and the motion of the other joints. Both are predicted by a
model, or measured in trial motions as in the paper. Over a region of poses, sets are ranked by the share of the poses
that they reach, and by leverage.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solver.arrays import FloatArray, select_poses
from solver.closing import close_loops
from solver.design.manifold import Manifold
from solver.design.motion import LIMITS, ChainMotion, chain_motion
from solver.design.paths import PathGraph
from solver.loops.closure import ClosureModel

SAMPLE = 200
SINGULAR_LEVERAGE = 0.02
"""Leverage below which the drives do not determine the free joints (a singularity)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RankedDrives:
    """One set of drive joints with its figures of merit.

    Over a region, leverage, conditioning and ratios are medians over the poses that the set reaches.

    `drives`: joints (1-based) to be put into position mode.
    `score`: value by which sets are ranked, in [0, 1]; 0 for a set that is not usable.
    `leverage`: how well the drives determine all motion, from 0 at a singularity to 1 (see `ChainMotion.leverage`).
    `passive_conditioning`: smallest singular value of the passive joints' closure Jacobian; None if ranked by trials.
    `fastest_passive`, `fastest_joint`: largest ratio of a passive joint's speed to the drives', and which joint has it.
    `reach`: share of the region's poses that can be reached from pose 0; None for a ranking at one pose.
    `still`: passive joints that hardly move. `reasons`: reasons for the rank, as text, the most important first.
    """

    drives: tuple[int, ...]
    score: float
    usable: bool
    leverage: float
    passive_conditioning: float | None
    fastest_passive: float
    fastest_joint: int
    still: tuple[int, ...]
    reach: float | None
    reasons: tuple[str, ...]


def rank_at_pose(model: ClosureModel, x: FloatArray, q: FloatArray) -> tuple[RankedDrives, ...]:
    """Rank all drive sets at the closed pose nearest to `q` (n,), rad, best first."""
    pose = close_loops(model, x, np.asarray(q, dtype=np.float64)[None, :])
    motion = chain_motion(model, x, pose.q, pose.u)
    sets = _sets(model, motion.degrees)
    return _sorted(_ranked(motion, drives) for drives in sets)


def rank_over_region(manifold: Manifold) -> tuple[RankedDrives, ...]:
    """Rank all drive sets, best first, by leverage and by the share of the manifold's poses reached from pose 0."""
    ranked = []
    for drives in _sets(manifold.model, manifold.motion.degrees):
        reachable = PathGraph(manifold, [drives], LIMITS).reachable(0)
        indices = np.flatnonzero(reachable)
        # Medians need no more than some hundreds of poses.
        indices = indices[:: max(1, len(indices) // SAMPLE)]
        motion = select_poses(manifold.motion, indices, "tangent", "jacobian")
        ranked.append(_ranked(motion, drives, reach=float(reachable.mean())))
    return _sorted(ranked)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveTrial:
    """Measured trial motions of one drive set.

    `drives`: joints (1-based) in position mode. `stopped`: why the trial ended early, as text; "" if it did not.
    `commanded_rad` (w, d): commanded displacement of the d drives in each of w trial motions; this matrix has rank d.
    `moved_rad` (w, n): measured displacement of every joint in each trial motion.
    """

    drives: tuple[int, ...]
    commanded_rad: FloatArray
    moved_rad: FloatArray
    stopped: str = ""


def rank_by_trial(trials: Sequence[DriveTrial]) -> tuple[RankedDrives, ...]:
    """Rank drive sets by the measured motion of the chain (paper, section 3), best first, without a model."""
    return _sorted(map(_ranked_by_trial, trials))


def _sets(model: ClosureModel, degrees: int) -> list[tuple[int, ...]]:
    usable = [j for j in range(1, model.joint_count + 1) if j not in model.unsensed_joints]
    return list(combinations(usable, degrees))


def _ranked(
    motion: ChainMotion, drives: tuple[int, ...], *, reach: float | None = None
) -> RankedDrives:
    rates = np.median(np.linalg.norm(motion.rates(drives), axis=-1), axis=0)
    leverage = float(np.median(motion.leverage(drives)))
    conditioning = float(np.median(motion.passive_conditioning(drives)))
    return _verdict(drives, leverage, rates, conditioning=conditioning, reach=reach)


def _ranked_by_trial(trial: DriveTrial) -> RankedDrives:
    # Motion of every joint per motion of each drive, (n, d).
    measured = np.linalg.lstsq(trial.commanded_rad, trial.moved_rad, rcond=None)[0].T
    followed = float(np.diagonal(measured[[j - 1 for j in trial.drives]]).min())
    # All joints move by R d when the drives move by d, so |d| is at least 1 / sigma_max(R) of the whole motion.
    leverage = min(float(1.0 / np.linalg.svd(measured, compute_uv=False)[0]), 1.0)
    stopped = trial.stopped
    if not stopped and followed < 0.8:
        stopped = f"a drive moved only {followed:.0%} of its commanded angle"
    return _verdict(trial.drives, leverage, np.linalg.norm(measured, axis=-1), stopped=stopped)


def _verdict(
    drives: tuple[int, ...],
    leverage: float,
    rates: FloatArray,
    *,
    conditioning: float | None = None,
    reach: float | None = None,
    stopped: str = "",
) -> RankedDrives:
    """Return the set `drives` with its score and reasons.

    `rates` (n,): motion of each joint, divided by the motion of the drives. `conditioning`: value for the field
    `passive_conditioning`. `stopped`: why a trial ended early, or "". `leverage`, `reach`: see `RankedDrives`.
    """
    rates = np.where(np.isin(np.arange(1, len(rates) + 1), drives), 0.0, rates)
    passive = [j for j in range(1, len(rates) + 1) if j not in drives]
    still = tuple(j for j in passive if rates[j - 1] < 0.05)
    joint = int(np.argmax(rates)) + 1
    fastest = float(rates[joint - 1])
    usable = leverage >= LIMITS.least_leverage and fastest <= LIMITS.most_rate and not stopped
    reasons = [f"the trial stopped: {stopped}"] if stopped else []
    if leverage < SINGULAR_LEVERAGE:
        reasons.append("singular: the drives do not determine the free joints")
    elif leverage < LIMITS.least_leverage:
        reasons.append(
            f"nearly singular: a motion of the drives may move the chain {1.0 / leverage:.0f} times as far"
        )
    if reach is not None:
        reasons.append(f"reaches {reach:.0%} of the poses inside the ranges")
    if still:
        names = " and ".join(f"J{j}" for j in still)
        reasons.append(f"{names} hardly move{'s' * (len(still) == 1)}")
    most = f"J{joint} moves most, {fastest:.1f} times as far as the drives"
    reasons.append(most if passive else "no passive joint")
    # The paper's criterion is the motion of the remaining joints; rates above 1 (near a singularity) count as 1.
    passive_rate = float(np.minimum(rates, 1.0).sum()) / max(1, len(passive))
    score = (leverage * passive_rate) ** 0.5 if reach is None else reach * (0.5 + 0.5 * leverage)
    return RankedDrives(
        drives=drives,
        score=score if usable else 0.0,
        usable=usable,
        leverage=leverage,
        passive_conditioning=conditioning,
        fastest_passive=fastest,
        fastest_joint=joint,
        still=still,
        reach=reach,
        reasons=tuple(reasons),
    )


def _sorted(ranked: Iterable[RankedDrives]) -> tuple[RankedDrives, ...]:
    return tuple(sorted(ranked, key=lambda r: (-r.score, -r.leverage, r.drives)))

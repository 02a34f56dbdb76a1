"""Decides when to stop taking poses: the precision is reached, or no further pose helps.

Every pose reduces noise a little, so a forecast decides whether more poses help. The forecast adds the remaining poses
one after the other, each time the one that most improves the parameter farthest above its requested uncertainty. More
poses help if the forecast reaches the requested uncertainties or comes noticeably nearer to them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.design.d_optimal import PoseInformation
from solver.estimators.least_squares import column_scale

UNDETERMINED_SHARE = 1e-12
"""A direction with less scaled information than this share of the largest is undetermined. Rounding errors are smaller,
about 1e-13 after the elimination of the effects."""

WORTHWHILE_SHARE = 0.05
"""More poses are worth taking if together they reduce the largest ratio of sigma to request by at least this share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WeakParameter:
    """A parameter whose uncertainty exceeds the requested one.

    `name`: paper notation. `sigma`, `requested`: standard deviation now and requested, rad or m; `sigma` is inf if the
    parameter is not determined at all. `forecast`: standard deviation after all remaining poses.
    """

    name: str
    sigma: float
    requested: float
    forecast: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StopDecision:
    """Whether to stop, the reason, and the parameters that are not yet precise enough.

    `weak`: parameters less precise than requested, the worst (largest ratio of sigma to request) first; empty if the
    precision is reached. `text`: the decision in one sentence.
    """

    stop: bool
    weak: tuple[WeakParameter, ...]
    text: str


def standard_deviations(information: FloatArray, parameters: int) -> FloatArray:
    """Standard deviations (P,) of the parameters from an information matrix (N, N); inf where undetermined.

    The first P = `parameters` of the N unknowns are parameters; the others are nuisance parameters with prior N(0, 1).
    """
    pp, pe = information[:parameters, :parameters], information[:parameters, parameters:]
    ee = information[parameters:, parameters:] + np.eye(len(information) - parameters)
    information = pp - pe @ np.linalg.solve(ee, pe.T)
    d = np.sqrt(np.diagonal(information))
    d = np.where(d > 0.0, d, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(d, d))
    undetermined = values <= UNDETERMINED_SHARE * max(float(values[-1]), 1e-300)
    variance = (vectors[:, ~undetermined] ** 2 / values[~undetermined]).sum(-1)
    affected = (vectors[:, undetermined] ** 2).sum(-1) > 1e-6
    return np.asarray(np.where(affected, np.inf, np.sqrt(variance) / d))


def stop_decision(
    information: FloatArray,
    candidates: PoseInformation,
    requested: Mapping[str, float],
    *,
    poses_left: int,
    allowed: BoolArray,
) -> StopDecision:
    """Decide whether to stop, from the information so far (N, N) and the requested standard deviations.

    `candidates`: information of m candidate poses about the same N unknowns. `requested`: requested standard deviation,
    rad or m, of each parameter to be checked, by name. `poses_left`: number of poses that may still be taken. `allowed`
    (m,): whether each candidate can be reached. Raises `ValueError` if `requested` has an unknown name.
    """
    if unknown := sorted(set(requested) - set(candidates.parameters)):
        raise ValueError(f"no parameter {', '.join(unknown)} in this calibration")
    names = [name for name in candidates.parameters if name in requested]
    columns = [candidates.parameters.index(name) for name in names]
    goal = np.array([requested[name] for name in names])
    P = len(candidates.parameters)
    now = standard_deviations(information, P)[columns]
    if np.all(now <= goal):
        return StopDecision(
            stop=True,
            weak=(),
            text="every parameter is known as well as requested, for errors of stated size",
        )
    root = candidates.root[allowed]
    later, needed = _forecast(information, root, P, np.array(columns), goal, poses_left)
    order = np.argsort(-_ratio(now, goal), kind="stable")
    weak = tuple(
        WeakParameter(
            name=names[k], sigma=float(now[k]), requested=float(goal[k]), forecast=float(later[k])
        )
        for k in order
        if now[k] > goal[k]
    )
    if needed is not None:
        text = f"about {needed} more poses to reach the request; {weak[0].name} is weakest"
        return StopDecision(stop=False, weak=weak, text=text)
    short = [w.name for w in weak if w.forecast > w.requested] or [weak[0].name]
    worst = max(weak, key=lambda w: w.forecast / w.requested)
    named = ", ".join(short[:3]) + (f" and {len(short) - 3} others" if len(short) > 3 else "")
    text = (
        f"{poses_left} more poses would not bring {named} to the request: "
        f"{worst.name} would stay {worst.forecast / worst.requested:.1f} times too uncertain"
        if poses_left
        else f"{named} not known as well as requested: "
        f"{worst.name} is {worst.sigma / worst.requested:.1f} times too uncertain"
    )
    nearer = _ratio(later, goal).max() < (1.0 - WORTHWHILE_SHARE) * _ratio(now, goal).max()
    return StopDecision(stop=not nearer, weak=weak, text=text)


def _forecast(
    information: FloatArray,
    root: FloatArray,
    P: int,
    columns: FloatArray,
    goal: FloatArray,
    poses_left: int,
) -> tuple[FloatArray, int | None]:
    """Return standard deviations after more poses, and the number of these poses.

    The standard deviations are those of the unknowns with the indices `columns`. Poses are added until all standard
    deviations are within `goal`. If `poses_left` poses are not enough, the number is None. Each added pose is the
    candidate that most reduces the variance of the parameter farthest above its goal. `root` (m, r, N):
    `PoseInformation.root` of the candidates. `P`: number of parameters, which are the first of the N unknowns.
    """
    M = information.copy()
    if len(root) == 0:
        return standard_deviations(M, P)[columns], None
    prior = np.ones(len(M))
    prior[:P] = column_scale(root[..., :P].reshape(-1, P)) ** 2 * (1e-8 / len(root))
    for added in range(poses_left + 1):
        sigma = standard_deviations(M, P)[columns]
        if np.all(sigma <= goal):
            return sigma, added
        if added == poses_left:
            break
        worst = int(columns[int(np.argmax(_ratio(sigma, goal)))])
        # Variance of parameter k falls by |C_k F'|^2 in the metric (I + F C F')^-1.
        C = np.linalg.inv(M + np.diag(prior))
        FC = root @ C
        S = FC @ np.swapaxes(root, -1, -2) + np.eye(root.shape[-2])
        column = FC[..., worst]
        fall = (column * np.linalg.solve(S, column[..., None])[..., 0]).sum(-1)
        best = root[int(np.argmax(fall))]
        M = M + best.T @ best
    return sigma, None


def _ratio(sigma: FloatArray, goal: FloatArray) -> FloatArray:
    return np.asarray(np.where(np.isfinite(sigma), sigma / goal, 1e300))

"""D-optimal choice of poses: the set whose information matrix has the largest determinant.

Greedy addition, then exchange of chosen poses for better candidates until no exchange helps
(Fedorov 1972). With M the information so far and F the r rows of a candidate,
``det(M + F'F) = det(M) det(I + F M^-1 F')``: one product over all candidates and a determinant of
size r each, so a whole round costs milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.estimators.least_squares import column_scale

PRIOR_SHARE = 1e-8
"""Weight of the prior that makes the first choices comparable, against one average candidate."""
MOST_RESTARTS = 24
RESTART_WORK = 30_000
"""Small problems have bad local optima and are cheap: they are started again, up to this many
candidates times poses altogether. Among thousands of candidates one start is within a percent."""
WORTHWHILE = 1e-9
"""An exchange that gains less log det than this is rounding."""


class TooFewCandidatesError(ValueError):
    """Not as many poses can be chosen as were asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSelection:
    """A chosen set of poses.

    Attributes
    ----------
    chosen
        Indices of the candidates, in the order of choice.
    log_det
        log det of the information of the fixed part and the chosen poses, in the parameters' own
        units; -inf when they do not determine all parameters.
    exchanges
        How many exchanges improved the greedy choice.
    """

    chosen: tuple[int, ...]
    log_det: float
    exchanges: int


def log_det(information: FloatArray) -> float:
    """Log determinant of an information matrix (P, P), computed with unit diagonal; -inf if singular."""
    d = np.sqrt(np.diagonal(information))
    if np.any(d <= 0.0):
        return float("-inf")
    sign, value = np.linalg.slogdet(information / np.outer(d, d))
    return float(value + 2.0 * np.log(d).sum()) if sign > 0 else float("-inf")


def gains(root: FloatArray, information: FloatArray) -> FloatArray:
    """log det gained by adding each candidate (m,) to a regular information matrix (P, P).

    `root` is (m, r, P): `PoseInformation.root`.
    """
    m, r, P = root.shape
    L = np.linalg.cholesky(information)
    white = (root.reshape(-1, P) @ np.linalg.inv(L).T).reshape(m, r, P)
    return _log_det_one_plus(white @ np.swapaxes(white, -1, -2))


def choose_poses(
    root: FloatArray,
    count: int,
    *,
    fixed: FloatArray | None = None,
    allowed: BoolArray | None = None,
    q: FloatArray | None = None,
    apart_rad: float = 0.0,
    max_sweeps: int = 10,
    seed: int = 0,
) -> PoseSelection:
    """Choose `count` different candidates of largest log det, beside what is known already.

    Parameters
    ----------
    root
        (m, r, P) of all candidates.
    fixed
        Information (P, P) of poses captured already.
    allowed
        (m,): which candidates may be chosen; all by default.
    q, apart_rad
        Joint angles (m, n) of the candidates and how far apart (Euclidean, rad) chosen ones have to
        be. Without it the best set repeats a few poses, which averages sensor noise but never a
        sensor's curve.

    Raises
    ------
    TooFewCandidatesError
        If fewer than `count` candidates are allowed, or keep apart.
    """
    m, _, P = root.shape
    usable = np.ones(m, dtype=np.bool_) if allowed is None else allowed.copy()
    pool = _Pool(usable, q if apart_rad > 0.0 else None, apart_rad)
    if count > int(usable.sum()):
        raise TooFewCandidatesError(f"{count} poses asked of {int(usable.sum())} candidates")
    scale = column_scale(root.reshape(-1, P))
    scaled = root / scale
    # Unit columns over all candidates: the average candidate has information 1/m on the diagonal.
    M = np.eye(P) * (PRIOR_SHARE / m)
    if fixed is not None:
        M = M + fixed / np.outer(scale, scale)
    rng = np.random.default_rng(seed)
    best: tuple[float, list[int], int] = (-np.inf, [], 0)
    for start in range(1 + min(MOST_RESTARTS, RESTART_WORK // (m * count))):
        chosen, current = [], M.copy()
        if start > 0:
            # Half at random, the rest by greed: another basin, yet not a bad one.
            chosen = _random_start(pool, count // 2, rng)
            rows = scaled[chosen].reshape(-1, P)
            current += rows.T @ rows
        _fill(scaled, current, pool, chosen, count)
        exchanges = _exchange(scaled, current, pool, chosen, max_sweeps)
        value = log_det(current)
        if start == 0 or value > best[0] + WORTHWHILE:
            best = value, chosen, exchanges
    rows = scaled[best[1]].reshape(-1, P)
    total = rows.T @ rows
    if fixed is not None:
        total = total + fixed / np.outer(scale, scale)
    return PoseSelection(
        chosen=tuple(best[1]),
        log_det=log_det(total) + 2.0 * float(np.log(scale).sum()),
        exchanges=best[2],
    )


def _random_start(pool: _Pool, count: int, rng: np.random.Generator) -> list[int]:
    chosen: list[int] = []
    for _ in range(count):
        left = np.flatnonzero(pool.open(chosen))
        if len(left) == 0:
            break
        chosen.append(int(rng.choice(left)))
    return chosen


def _fill(
    root: FloatArray,
    M: FloatArray,
    pool: _Pool,
    chosen: list[int],
    count: int,
) -> None:
    """Add the best candidate, one after the other, until there are `count`."""
    while len(chosen) < count:
        gain = np.where(pool.open(chosen), gains(root, M), -np.inf)
        best = int(np.argmax(gain))
        if not np.isfinite(gain[best]):
            raise TooFewCandidatesError(
                f"only {len(chosen)} of {count} poses keep {pool.apart_rad:.3f} rad from each other"
            )
        M += root[best].T @ root[best]
        chosen.append(best)


def next_best(
    root: FloatArray, information: FloatArray, *, allowed: BoolArray | None = None
) -> tuple[int, float]:
    """Candidate that adds most to the information (P, P) of the poses so far, and its log det gain.

    The information may be singular, as it is at first.
    """
    m, _, P = root.shape
    scale = column_scale(root.reshape(-1, P))
    M = information / np.outer(scale, scale) + np.eye(P) * (PRIOR_SHARE / m)
    gain = gains(root / scale, M)
    if allowed is not None:
        gain = np.where(allowed, gain, -np.inf)
    best = int(np.argmax(gain))
    return best, float(gain[best])


@dataclass(frozen=True, slots=True)
class _Pool:
    """Which candidates may still be chosen beside those that are."""

    usable: BoolArray
    q: FloatArray | None
    apart_rad: float

    def open(self, chosen: Sequence[int]) -> BoolArray:
        left = self.usable.copy()
        left[list(chosen)] = False
        if self.q is not None:
            for pose in chosen:
                left &= ((self.q - self.q[pose]) ** 2).sum(-1) >= self.apart_rad**2
        return left


def _exchange(
    root: FloatArray,
    M: FloatArray,
    pool: _Pool,
    chosen: list[int],
    max_sweeps: int,
) -> int:
    """Take out one pose at a time and put in the best, until a whole sweep changes nothing."""
    exchanges = 0
    for _ in range(max_sweeps):
        changed = False
        for k, old in enumerate(chosen):
            without = M - root[old].T @ root[old]
            others = [pose for pose in chosen if pose != old]
            gain = np.where(pool.open(others), gains(root, without), -np.inf)
            stay = float(gains(root[old : old + 1], without)[0])
            best = int(np.argmax(gain))
            if gain[best] > stay + WORTHWHILE:
                M[:] = without + root[best].T @ root[best]
                chosen[k] = best
                exchanges += 1
                changed = True
        if not changed:
            break
    return exchanges


def _log_det_one_plus(S: FloatArray) -> FloatArray:
    """log det(I + S) of symmetric positive S (m, r, r)."""
    r = S.shape[-1]
    diagonal = np.linalg.cholesky(S + np.eye(r))[..., range(r), range(r)]
    return np.asarray(2.0 * np.log(diagonal).sum(-1))


def efficiency(first: float, second: float, parameters: int) -> float:
    """D-efficiency of a design of log det `first` against `second`: 0.5 needs twice the poses."""
    return float(np.exp((first - second) / parameters))

"""Change points: score tests for a step change of any suspected quantity ("suspect") at any pose.

A suspect is a joint's offset, a length, or the placement of one half of the fixture. It changes by a constant amount
from some pose k on. The poses are in time order, so cumulative sums test every k at once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from solver.arrays import FloatArray
from solver.diagnostics.fault_models import Candidate, Cause
from solver.diagnostics.limits import FALSE_ALARM_PROBABILITY, STEP_EDGE_POSES
from solver.diagnostics.whitened_residuals import WhitenedResiduals

AT_POSES = 0.4
"""False-alarm rate of the test, whose steps are at poses, divided by the rate for steps at any time (`step_threshold`).
Simulated for 10 to 300 poses."""

FREE = 1e-7
"""A step is detectable only if, after the fit, at least this share of the sum of squares of its column remains."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangePoint:
    """The most significant step of one suspect (see the module).

    `pose`: index in time order of the first pose after the step.
    `size` (d,): step of each of the suspect's d quantities, rad or m.
    `chi2`: reduction of chi2 when the step is fitted.
    `threshold`: the step is significant if `chi2` exceeds this. If there is no step, the probability that any suspect
    exceeds its threshold at any pose is `FALSE_ALARM_PROBABILITY`.
    """

    suspect: Candidate
    pose: int
    size: FloatArray
    chi2: float
    threshold: float


def steps(
    residuals: WhitenedResiduals,
    suspects: Sequence[Candidate],
    *,
    low_noise: WhitenedResiduals | None = None,
    scale: float = 1.0,
) -> tuple[ChangePoint, ...]:
    """Return the most significant step of each suspect, in order of significance.

    `residuals`: whitened residuals of the fit, poses in time order.
    `low_noise`: residuals whitened with smaller noise, used for steps of a joint's reading.
    `scale`: ratio of the actual variances to the variances of the fit. Chi2 is divided by this ratio.
    """
    m = len(residuals.white)
    if m < 2 * STEP_EDGE_POSES or not suspects:
        return ()
    level = FALSE_ALARM_PROBABILITY / sum(s.false_alarm_share for s in suspects)
    change_points = []
    for suspect in suspects:
        of_reading = suspect.cause is Cause.LOST_COUNTS
        tested = low_noise if of_reading and low_noise is not None else residuals
        change_points.append(_largest(tested, suspect, scale, level))
    return tuple(sorted(filter(None, change_points), key=lambda step: step.threshold - step.chi2))


def _largest(
    residuals: WhitenedResiduals, suspect: Candidate, scale: float, level: float
) -> ChangePoint | None:
    """Return the most significant step of a suspect with d columns; None if no step is detectable.

    `scale`: ratio of actual to assumed variances. `level`: false-alarm probability if `false_alarm_share` is 1.
    """
    m = len(residuals.white)
    white = residuals.whiten(suspect.columns)
    across = np.swapaxes(white, -1, -2)
    s = _sums_from_each_pose((across @ residuals.white[..., None])[..., 0])
    own = _sums_from_each_pose(across @ white)
    inside = _sums_from_each_pose(across @ residuals.U)
    C = own - inside @ np.swapaxes(inside, -1, -2)
    # Scaled, so that metres and radians count equally.
    size = np.sqrt(np.diagonal(own, axis1=-2, axis2=-1).max(axis=0))
    if not (size > 0.0).all():
        return None
    places = slice(STEP_EDGE_POSES, m - STEP_EDGE_POSES + 1)
    values, vectors = np.linalg.eigh(C[places] / np.outer(size, size))
    free = values > FREE
    along = (np.swapaxes(vectors, -1, -2) @ (s[places] / size)[..., None])[..., 0]
    inverse = np.where(free, 1.0 / np.where(free, values, 1.0), 0.0)
    chi2 = (along**2 * inverse).sum(-1)
    k = int(np.argmax(chi2))
    if not free[k].any():
        return None
    return ChangePoint(
        suspect=suspect,
        pose=k + STEP_EDGE_POSES,
        size=(vectors[k] @ (inverse[k] * along[k])) / size,
        chi2=float(chi2[k]) / scale,
        threshold=step_threshold(m, int(free[k].sum()), suspect.false_alarm_share * level),
    )


def _sums_from_each_pose(values: FloatArray) -> FloatArray:
    """Sums (m, ...) over each pose and all later poses."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])


@lru_cache(maxsize=256)
def step_threshold(poses: int, dof: int, false_alarm: float) -> float:
    """Return the value that the largest chi2 over all poses exceeds by chance with probability `false_alarm`.

    If there is no step, chi2 as a function of the step's pose behaves like the square of a standardised Brownian bridge
    in d = `dof` dimensions. At least the share h = `STEP_EDGE_POSES` / `poses` of the poses is before the step, and the
    same share after it. If a step may be at any time, the maximum of chi2 has the tail (Csorgo & Horvath 1997, 1.3.26)

        P(max > x) ~ x^(d/2) e^(-x/2) / (2^(d/2) Gamma(d/2)) ((1 - d/x) T + 4/x),   T = log((1-h)^2 / h^2).

    More than half of the cases in which the maximum exceeds x are between two poses. `AT_POSES` corrects for them.
    """
    from scipy.special import chdtri, gammaln

    h = STEP_EDGE_POSES / poses
    span = 2.0 * math.log((1.0 - h) / h)

    def log_tail(x: float) -> float:
        half = 0.5 * dof
        head = half * math.log(x) - 0.5 * x - half * math.log(2.0) - float(gammaln(half))
        return head + math.log(max((1.0 - dof / x) * span + 4.0 / x, 1e-300))

    # The threshold is at least that for one pose and at most that for independent poses.
    low = float(chdtri(dof, false_alarm))
    high = float(chdtri(dof, false_alarm / poses))
    target = math.log(false_alarm / AT_POSES)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if log_tail(middle) > target else (low, middle)
    return high

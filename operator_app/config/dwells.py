"""Finds the dwells (times at rest) in a recording of an arm; each dwell becomes one pose.

During a dwell, every joint's readings spread by at most a limit and drift by at most half of it. Long gaps between
samples do not count as time at rest.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.poses import PoseSet

DWELL_S = 1.0
DWELL_SPREAD_DEG = 0.05
"""Defaults: smallest duration of a dwell, and largest spread (maximum minus minimum) of a joint's readings in it."""

LEAST_SAMPLES = 5
GAP_STEPS, GAP_SHARE = 5.0, 0.25
"""A gap counts as observed time only up to GAP_STEPS median intervals or, if longer, GAP_SHARE of `dwell_s`."""

MOST_BISECTIONS = 6
"""Largest number of times that the limit of the spread is halved to separate dwells from slow motion between them."""

EDGE_SIGMAS = 5.0
"""Samples at the ends of a dwell count as motion if they differ from its median by over this many sigmas."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dwell:
    """A time at rest in a recording.

    `start_s`, `seconds`: start and duration.
    `first`, `samples`: index (in the recording) of the first sample of the dwell, and number of these samples.
    `mean_rad`, `sd_rad`: mean and standard deviation (n,) of these samples.
    """

    start_s: float
    seconds: float
    first: int
    samples: int
    mean_rad: FloatArray
    sd_rad: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedDwell:
    """A rest refused as a dwell. `joint` (from 1) moved by `moved_rad`; if `joint` is 0, the rest is too short."""

    start_s: float
    seconds: float
    joint: int = 0
    moved_rad: float = 0.0


def poses_of(
    dwells: Sequence[Dwell], utc_of: Callable[[float], str], endpoint: FloatArray | None = None
) -> PoseSet:
    """Return one pose per dwell, in order.

    `endpoint`: measured endpoints (m, 3) or (m, 6), m and rad; None without an instrument. `utc_of` formats a start
    time (s) as UTC; it returns "" if the log's times are not calendar times.
    """
    utc = tuple(utc_of(d.start_s) for d in dwells)
    return PoseSet(
        placement=np.ones(len(dwells), dtype=np.int64),
        label=tuple(str(k) for k in range(1, len(dwells) + 1)),
        q_rad=np.array([d.mean_rad for d in dwells]),
        sd_rad=np.array([d.sd_rad for d in dwells]),
        samples=np.array([d.samples for d in dwells], dtype=np.int64),
        endpoint=endpoint,
        utc=utc if all(utc) else None,
        notes=tuple(f"at rest for {d.seconds:.2f} s from {d.start_s:.2f} s" for d in dwells),
    )


def find_dwells(
    time_s: FloatArray,
    q_rad: FloatArray,
    *,
    dwell_s: float = DWELL_S,
    spread_rad: float = math.radians(DWELL_SPREAD_DEG),
) -> tuple[tuple[Dwell, ...], tuple[RefusedDwell, ...]]:
    """Return the dwells in samples `q_rad` (m, n) at rising times `time_s` (m,), and the rests that were refused."""
    if len(time_s) < LEAST_SAMPLES:
        return (), ()
    step = np.diff(time_s)
    most_s = max(GAP_STEPS * float(np.median(step)), GAP_SHARE * dwell_s)
    observed_s = np.concatenate(([0.0], np.cumsum(np.minimum(step, most_s))))
    dwells: list[Dwell] = []
    refused: list[RefusedDwell] = []
    used = np.zeros(len(time_s), dtype=bool)
    pending = [(0, len(time_s), spread_rad, 0)]
    while pending:
        begin, end, limit, depth = pending.pop()
        for a, b in _at_rest(observed_s[begin:end], q_rad[begin:end], dwell_s, limit):
            first, last = begin + a, begin + b
            dwell = _dwell(time_s, observed_s, q_rad, (first, last), spread_rad)
            if isinstance(dwell, RefusedDwell) and depth < MOST_BISECTIONS:
                pending.append((first, last + 1, 0.5 * limit, depth + 1))
            elif isinstance(dwell, Dwell):
                dwells.append(dwell)
                used[first : last + 1] = True
    edges = np.flatnonzero(np.diff(np.concatenate(([True], used, [True])).astype(int)))
    for begin, end in edges.reshape(-1, 2).tolist():
        for a, b in _at_rest(observed_s[begin:end], q_rad[begin:end], 0.5 * dwell_s, spread_rad):
            first, last = begin + a, begin + b
            start, seconds = float(time_s[first]), float(observed_s[last] - observed_s[first])
            moved_rad = np.ptp(q_rad[first : last + 1], axis=0)
            if moved_rad.max() <= spread_rad and seconds < dwell_s:
                refused.append(RefusedDwell(start_s=start, seconds=seconds))
            else:
                refused.append(_moving(start, seconds, moved_rad))
    return tuple(sorted(dwells, key=lambda d: d.start_s)), tuple(refused)


def smallest_spread_rad(time_s: FloatArray, q_rad: FloatArray, dwell_s: float) -> float:
    """Return the smallest spread, rad, that all joints keep to in some window of `dwell_s` s; inf without window."""
    last = np.searchsorted(time_s, time_s + dwell_s * (1.0 - 1e-9))
    return float(_ranges(q_rad, last[last < len(time_s)]).max(axis=1).min(initial=np.inf))


def _moving(start_s: float, seconds: float, moved_rad: FloatArray) -> RefusedDwell:
    joint, most = int(np.argmax(moved_rad)) + 1, float(moved_rad.max())
    return RefusedDwell(start_s=start_s, seconds=seconds, joint=joint, moved_rad=most)


def _dwell(
    time_s: FloatArray,
    observed_s: FloatArray,
    q_rad: FloatArray,
    ends: tuple[int, int],
    spread_rad: float,
) -> Dwell | RefusedDwell:
    """Return the dwell in samples `ends[0]` to `ends[1]`, without motion at either end, or else the refused dwell.

    `time_s`, `observed_s`: time of each sample, s; in `observed_s`, long gaps are shortened.
    """
    at_rest = q_rad[ends[0] : ends[1] + 1]
    away = np.abs(at_rest - np.median(at_rest, axis=0))
    noise = 1.4826 * np.median(away, axis=0)
    inside = np.flatnonzero(np.all(away <= np.maximum(EDGE_SIGMAS * noise, 1e-9), axis=1))
    a, b = ends
    if len(inside) >= LEAST_SAMPLES:
        a, b = a + int(inside[0]), a + int(inside[-1])
    q, at = q_rad[a : b + 1], observed_s[a : b + 1]
    centred = at - at.mean()
    drift = np.abs(centred @ q) / (centred @ centred) * (at[-1] - at[0])
    spread = np.ptp(q, axis=0)
    start, seconds = float(time_s[a]), float(at[-1] - at[0])
    if spread.max() > spread_rad:
        return _moving(start, seconds, spread)
    if drift.max() > 0.5 * spread_rad:
        return _moving(start, seconds, drift)
    mean, sd = q.mean(axis=0), q.std(axis=0, ddof=1)
    return Dwell(start_s=start, seconds=seconds, first=a, samples=len(q), mean_rad=mean, sd_rad=sd)


def _at_rest(
    at_s: FloatArray, q_rad: FloatArray, window_s: float, spread_rad: float
) -> Iterator[tuple[int, int]]:
    """Yield first and last index of each rest.

    A rest consists of overlapping windows of `window_s` in which no joint's readings spread by more than `spread_rad`.
    """
    count = len(at_s)
    first = np.arange(count)
    last = np.maximum(
        np.searchsorted(at_s, at_s + window_s * (1.0 - 1e-9)), first + LEAST_SAMPLES - 1
    )
    first = first[last < count]
    last = last[last < count]
    rest = np.flatnonzero(_ranges(q_rad, last).max(axis=1, initial=0.0) <= spread_rad)
    if not len(rest):
        return
    begins, ends = first[rest], last[rest]
    # Windows are in order of their ends: a rest ends if the next window does not overlap it.
    cuts = np.flatnonzero(begins[1:] > ends[:-1])
    for a, b in zip((0, *(cuts + 1)), (*cuts, len(rest) - 1), strict=True):
        yield int(begins[a]), int(ends[b])


def _ranges(q_rad: FloatArray, last: IntArray) -> FloatArray:
    """Return ranges (len(last), n); row k is the maximum minus the minimum of `q_rad[k : last[k] + 1]`."""
    length = last - np.arange(len(last)) + 1
    ranges = np.zeros((len(last), q_rad.shape[1]))
    high = low = q_rad
    for level in range(int(length.max(initial=0)).bit_length()):
        size = 1 << level
        rows = np.flatnonzero(length >> level == 1)
        other = last[rows] - size + 1
        ranges[rows] = np.maximum(high[rows], high[other]) - np.minimum(low[rows], low[other])
        high = np.maximum(high[:-size], high[size:])
        low = np.minimum(low[:-size], low[size:])
    return ranges

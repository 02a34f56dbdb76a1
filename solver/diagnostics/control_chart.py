"""Control charts of several quantities measured in every session: Shewhart and EWMA, with change points.

Source: NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2 (Shewhart, EWMA) and 2.3.5 (control of a measurement
process by a check standard: within- and between-session standard deviations).

As there is no long history, the limits follow from the scatter within a baseline of earlier sessions. The baseline
omits the last `RECENT` sessions if enough others remain, so that it does not contain a recent shift. The few sessions
of a baseline determine a variance poorly. So each quantity's observed variance is averaged with an expected variance of
weight `PRIOR_DOF` (Smyth 2004, "moderated t"). The expected variance is the stated one times a common factor: the ratio
of observed to stated variances over all quantities. The EWMA gets nearly all of the false-alarm probability, because
outliers affect an average less than a single value.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.diagnostics.limits import CONTROL_CHART_FALSE_ALARM_PROBABILITY

BASELINE = 4
"""Smallest number of earlier sessions with which a session is tested."""

RECENT = 3
"""The EWMA averages this many sessions, the last of which is the tested one. The baseline omits these sessions if
enough others remain."""

LAMBDA = 0.3
"""Weight of the newest value in the EWMA; the Handbook recommends 0.2 to 0.3."""

PRIOR_DOF = 8.0
"""Weight, in degrees of freedom, of a quantity's expected variance (see the module). The ratio of observed to stated
scatter of a single quantity differs from the ratio over all quantities by about 25 %."""

SHEWHART_SHARE = 0.1
"""Probability of a false alarm in the Shewhart chart divided by that in the EWMA chart. Shifts of six times the scatter
show in both charts."""

LEAST_RATIO = 0.1
"""The scatter between sessions is assumed to be at least this share of the stated repeatability."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartSignal:
    """Shift of the quantity `name` that a chart detected.

    `at`: first session after the shift. `detected_at`: session of the detection. Both count from 0.
    `size`, `sigma`: size of the shift, and its standard deviation. `chart`: ``shewhart`` or ``ewma``.
    """

    name: str
    at: int
    detected_at: int
    size: float
    sigma: float
    chart: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlChart:
    """Control limits and detected shifts. The arrays are (sessions, quantities), and NaN where nothing was tested.

    `centre`: mean of the baseline. `between`: standard deviation between sessions, as estimated from the baseline.
    `shewhart`: half width of the limits for a single value. `ewma_limit`: half width of the limits for `ewma`.
    `ewma`: weighted mean of recent values.
    `changes`: shifts in the order in which they were detected; each shift starts a new baseline of its quantity.
    """

    centre: FloatArray
    between: FloatArray
    shewhart: FloatArray
    ewma: FloatArray
    ewma_limit: FloatArray
    changes: tuple[ChartSignal, ...]


def control_chart(names: Sequence[str], values: FloatArray, within: FloatArray) -> ControlChart:
    """Test one session after the other; return the limits and the detected shifts.

    `values` (sessions, quantities): values of the quantities `names`, sessions in time order. `within`, of the same
    shape: stated repeatability of each value (type A standard uncertainty).
    """
    from scipy.special import stdtrit

    count, width = values.shape
    centre, between, shewhart, ewma, ewma_limit = np.full((5, count, width), np.nan)
    begin = np.zeros(width, dtype=np.int64)
    changes: list[ChartSignal] = []
    for t in range(BASELINE, count):
        tested = np.flatnonzero(t - begin >= BASELINE)
        if not len(tested):
            continue
        ends = np.where(t + 1 - RECENT - begin >= BASELINE, t + 1 - RECENT, t)
        variance, dof = _variances(values, within, begin, ends, tested)
        for j, var, nu in zip(tested.tolist(), variance.tolist(), dof.tolist(), strict=True):
            first, last = int(begin[j]), int(ends[j])
            mean, size = values[first:last, j].mean(), last - first
            recent = values[last : t + 1, j]
            weights = LAMBDA * (1.0 - LAMBDA) ** np.arange(len(recent))[::-1]
            weights /= weights.sum()
            tail = 0.5 * CONTROL_CHART_FALSE_ALARM_PROBABILITY / len(tested)
            limit, single_limit = -stdtrit(nu, (tail, SHEWHART_SHARE * tail))
            centre[t, j], between[t, j] = mean, np.sqrt(var)
            shewhart[t, j] = single_limit * np.sqrt(var * (1.0 + 1.0 / size))
            ewma[t, j] = weights @ recent
            ewma_limit[t, j] = limit * np.sqrt(var * (weights @ weights + 1.0 / size))
            single = abs(recent[-1] - mean) / shewhart[t, j]
            weighted = abs(ewma[t, j] - mean) / ewma_limit[t, j]
            if max(single, weighted) <= 1.0:
                continue
            chart = "shewhart" if single >= weighted else "ewma"
            start, shift, sigma = _change(values[first : t + 1, j], last - first, var)
            begin[j] = at = first + start
            signal = ChartSignal(
                name=names[j], at=at, detected_at=t, size=shift, sigma=sigma, chart=chart
            )
            changes.append(signal)
    return ControlChart(
        centre=centre,
        between=between,
        shewhart=shewhart,
        ewma=ewma,
        ewma_limit=ewma_limit,
        changes=tuple(changes),
    )


def smallest_shift(between: FloatArray, sessions: int, quantities: int) -> FloatArray:
    """Return the smallest shift of each quantity that `RECENT` further sessions detect with a probability of 90 %.

    `between` (`quantities`,): standard deviations between sessions. `sessions`: number of sessions in the baseline.
    """
    from scipy.special import stdtrit

    weights = LAMBDA * (1.0 - LAMBDA) ** np.arange(RECENT)
    weights /= weights.sum()
    dof = PRIOR_DOF + sessions - 1
    tail = 0.5 * CONTROL_CHART_FALSE_ALARM_PROBABILITY / quantities
    needed = -float(stdtrit(dof, tail)) - float(stdtrit(dof, 0.1))
    return np.asarray(needed * between * np.sqrt(weights @ weights + 1.0 / sessions))


def _variances(
    values: FloatArray, within: FloatArray, begin: IntArray, ends: IntArray, tested: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the variance of each quantity j in `tested` over the sessions ``begin[j]:ends[j]``, and its dof."""
    columns = [(slice(int(begin[j]), int(ends[j])), j) for j in tested.tolist()]
    own = np.array([values[column].var(ddof=1) for column in columns])
    # A value stated to repeat exactly still scatters by rounding.
    stated = np.maximum([np.mean(within[column] ** 2) for column in columns], 1e-24)
    nu = (ends - begin - 1.0)[tested]
    ratio = max(float(np.sum(nu * own / stated) / nu.sum()), LEAST_RATIO**2)
    prior = np.minimum(PRIOR_DOF, nu.sum())
    variance = (prior * ratio * stated + nu * own) / (prior + nu)
    return np.maximum(variance, LEAST_RATIO**2 * stated), prior + nu


def _change(values: FloatArray, baseline: int, variance: float) -> tuple[int, float, float]:
    """Return the most probable start of a shift (index in `values`, at least `baseline`), and its size and sigma."""
    best = (0, 0.0, 1.0)
    for k in range(baseline, len(values)):
        size = float(values[k:].mean() - values[:k].mean())
        sigma = float(np.sqrt(variance * (1.0 / k + 1.0 / (len(values) - k))))
        if abs(size) / sigma > abs(best[1]) / best[2]:
            best = (k, size, sigma)
    return best

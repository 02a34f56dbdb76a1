"""Control charts: how often a sound history raises an alarm, and how soon a shift is named."""

from collections.abc import Iterator

import numpy as np
import pytest

from solver.diagnostics.control_chart import ChartSignal, control_chart, smallest_shift
from solver.diagnostics.limits import CONTROL_CHART_FALSE_ALARM_PROBABILITY

NAMES = "abcde"
SESSIONS, ENTRIES = 12, len(NAMES)
STATED_DEG = np.array([0.0091, 0.018, 0.013, 0.016, 0.012])
"""Type A of arm entries."""


def histories(
    count: int,
    *,
    seed: int,
    shift_deg: float = 0.0,
    entries_differ: float = 0.15,
    sessions_differ: float = 0.0,
) -> Iterator[tuple[int, tuple[ChartSignal, ...]]]:
    """Twelve sessions with a correlated scatter of 0.010 deg on average, ten if there is a shift, and their changes.

    `entries_differ`, `sessions_differ`: standard deviations of the logarithm of the scatter.
    """
    rng = np.random.default_rng(seed)
    for _ in range(count):
        own = STATED_DEG / STATED_DEG.mean() * np.exp(rng.normal(0.0, entries_differ, ENTRIES))
        scatter = 0.010 * own / own.mean()
        correlation = np.full((ENTRIES, ENTRIES), 0.3) + 0.7 * np.eye(ENTRIES)
        noise = rng.multivariate_normal(np.zeros(ENTRIES), correlation, SESSIONS) * scatter
        if sessions_differ:
            noise *= np.exp(rng.normal(0.0, sessions_differ, (SESSIONS, 1)))
        values = rng.normal(0.0, 0.1, ENTRIES) + noise
        j = int(rng.integers(ENTRIES))
        values[7:, j] += shift_deg * rng.choice((-1.0, 1.0))
        within = np.tile(STATED_DEG * rng.uniform(0.7, 3.0), (SESSIONS, 1))
        last = SESSIONS if shift_deg == 0.0 else 10
        yield j, control_chart(NAMES, values[:last], within[:last]).changes


@pytest.mark.campaign
def test_at_most_5_percent_of_200_sound_histories_alarm():
    alarms = [np.mean([bool(result) for _, result in histories(200, seed=s)]) for s in range(10)]
    assert np.mean(alarms) <= 0.02
    assert max(alarms) <= 0.05


@pytest.mark.campaign
@pytest.mark.parametrize(("entries", "sessions"), [(0.35, 0.0), (0.15, 0.2), (0.15, 0.35)])
def test_unequal_scatter_raises_no_more_alarms(entries, sessions):
    result = histories(2000, seed=11, entries_differ=entries, sessions_differ=sessions)
    assert np.mean([bool(changes) for _, changes in result]) <= 0.05


@pytest.mark.campaign
def test_a_shift_of_0_05_deg_at_session_8_is_named_by_session_10():
    named, placed = [], []
    for j, result in histories(1000, seed=77, shift_deg=0.05):
        own = [c for c in result if c.name == NAMES[j] and c.at >= 6]
        named.append(bool(own))
        placed += [c.at == 7 for c in own[:1]]
    assert np.mean(named) >= 0.90
    assert np.mean(placed) >= 0.85


def test_a_shift_is_named_once_with_session_and_amount():
    values = np.random.default_rng(3).normal(0.0, 0.01, (20, 4))
    values[12:, 2] += 0.2
    result = control_chart("abcd", values, np.full((20, 4), 0.03))
    (change,) = result.changes
    assert (change.name, change.at, change.detected_at, change.chart) == ("c", 12, 12, "shewhart")
    assert change.size == pytest.approx(0.2, abs=0.03)
    assert np.isnan(result.centre[:4]).all()
    assert not np.isnan(result.centre[4:, :2]).any()
    # Four sessions after it the quantity is judged again, by its new level.
    assert np.isnan(result.centre[13:16, 2]).all()
    assert result.centre[17, 2] == pytest.approx(0.2, abs=0.02)


def test_limits_follow_the_scatter_not_the_stated_sigmas():
    values = np.random.default_rng(4).normal(0.0, 0.01, (40, 5))
    for stated in (0.01, 0.05, 0.002):
        result = control_chart(NAMES, values, np.full((40, 5), stated))
        assert result.changes == ()
        assert result.between[-1].mean() == pytest.approx(0.01, rel=0.25)
    least = smallest_shift(result.between[-1], 37, 5)
    assert np.all((least > 2.5 * result.between[-1]) & (least / result.between[-1] < 4.5))
    assert 0.0 < CONTROL_CHART_FALSE_ALARM_PROBABILITY < 0.05


def test_constant_values_raise_no_alarm():
    values = np.tile([0.1, 0.2], (9, 1))
    assert control_chart("ab", values, np.zeros((9, 2))).changes == ()
    values[8, 0] += 1e-6
    assert control_chart("ab", values, np.full((9, 2), 1e-5)).changes == ()

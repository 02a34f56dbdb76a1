"""The implicit estimator at the Cramer-Rao bound: the benchmark in small, with bounds for its size."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, chi2

from tests.benchmarks.monte_carlo import Study, study, table
from tests.oracles.simulated_loops import PARAMETERS, Simulation

pytestmark = pytest.mark.campaign

RUNS = 100
CHANCE = 1e-5
"""Of one bound failing although all is well; there are fewer than a hundred of them."""


@pytest.fixture(scope="module")
def small() -> Study:
    return study(RUNS, Simulation(poses=60, wrist_sd=6e-3), seed=0)


def test_errors_are_at_the_bound(small: Study) -> None:
    low, high = np.sqrt(chi2.ppf([CHANCE, 1.0 - CHANCE], RUNS) / RUNS)
    assert (low, high) == pytest.approx((0.72, 1.31), abs=0.02)
    ratios = small.ratio(small.implicit)
    assert ratios.min() > low
    assert ratios.max() < high
    # No single parameter may hide in the width of the others: the mean over all of them is tighter.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_errors_have_no_bias(small: Study) -> None:
    error = small.bound / np.sqrt(RUNS)
    assert np.abs(small.implicit.mean(axis=0) / error).max() < 4.5


def test_intervals_cover(small: Study) -> None:
    hits = small.covered.sum(axis=0)
    assert hits.min() >= binom.ppf(CHANCE, RUNS, 0.95)
    assert hits.max() <= binom.isf(CHANCE, RUNS, 0.95)
    assert small.covered.mean() == pytest.approx(0.95, abs=0.03)


def test_chi2_per_dof_is_one(small: Study) -> None:
    total = RUNS * (60 * 5 - len(PARAMETERS))
    low, high = chi2.ppf([CHANCE, 1.0 - CHANCE], total) / total
    assert low < small.chi2_per_dof.mean() < high


def test_paper_is_far_from_the_bound_where_encoders_are(small: Study) -> None:
    ratios = small.ratio(small.paper)
    assert ratios[:5].min() > 50.0
    assert 1.5 < ratios[5:7].max() < 50.0


def test_table_names_every_parameter(small: Study) -> None:
    text = table(small)
    assert all(name in text for name in PARAMETERS)

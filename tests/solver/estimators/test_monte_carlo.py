"""Many draws of noise: the implicit estimator is at the Cramer-Rao bound. Truth and bound come from the oracles."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import binom, chi2

from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from tests.oracles.loop_oracle import closed_poses, cramer_rao
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import NAMES, loop_of

pytestmark = pytest.mark.campaign

RUNS = 100
CHANCE = 1e-5
"""Of one bound failing although all is well; there are fewer than a hundred of them."""


NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Study:
    """Errors and figures of many runs on the same poses."""

    bound: np.ndarray  # (P,) standard deviations of the Cramer-Rao bound
    implicit: np.ndarray  # (runs, P) errors
    paper: np.ndarray  # (runs, P) errors
    covered: np.ndarray  # (runs, P) whether the 95 % interval holds the truth
    chi2_per_dof: np.ndarray  # (runs,)

    def ratio(self, errors: np.ndarray) -> np.ndarray:
        """RMSE over bound of every parameter."""
        return np.sqrt(np.mean(errors**2, axis=0)) / self.bound


@pytest.fixture(scope="module")
def small():
    simulation = Simulation(poses=60, wrist_sd=6e-3)
    truth = simulation.truth
    closed = closed_poses(truth, np.random.default_rng(0), simulation.poses)
    bound = cramer_rao(truth, closed, NAMES, simulation.sigma() ** 2)
    model, goal = loop_of(truth), truth.values(NAMES)
    noise = NoiseModel(joint_variance=simulation.sigma() ** 2)
    runs = []
    for seed in range(RUNS):
        q = simulation.read(closed, np.random.default_rng([seed, 7]))
        found = estimate_implicit(model, q, noise)
        error = found.x - goal
        covered = np.abs(error) < NORMAL_95 * found.standard_deviation
        paper = estimate_paper(model, q).x - goal
        runs.append((error, paper, covered, float(found.chi2 or np.nan) / found.dof))
    return Study(np.sqrt(np.diagonal(bound)), *(np.array(v) for v in zip(*runs, strict=True)))


def test_errors_are_at_the_bound(small):
    low, high = np.sqrt(chi2.ppf([CHANCE, 1.0 - CHANCE], RUNS) / RUNS)
    assert (low, high) == pytest.approx((0.72, 1.31), abs=0.02)
    ratios = small.ratio(small.implicit)
    assert ratios.min() > low
    assert ratios.max() < high
    # No single parameter may hide in the width of the others: the mean over all of them is tighter.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_errors_have_no_bias_on_average(small):
    error = small.bound / np.sqrt(RUNS)
    assert np.abs(small.implicit.mean(axis=0) / error).max() < 4.5


def test_intervals_cover_the_truth(small):
    hits = small.covered.sum(axis=0)
    assert hits.min() >= binom.ppf(CHANCE, RUNS, 0.95)
    assert hits.max() <= binom.isf(CHANCE, RUNS, 0.95)
    assert small.covered.mean() == pytest.approx(0.95, abs=0.03)


def test_chi2_per_dof_is_one_on_average(small):
    total = RUNS * (60 * 5 - len(NAMES))
    low, high = chi2.ppf([CHANCE, 1.0 - CHANCE], total) / total
    assert low < small.chi2_per_dof.mean() < high


def test_the_papers_estimate_is_far_from_the_bound(small):
    ratios = small.ratio(small.paper)
    assert ratios[:5].min() > 50.0
    assert 1.5 < ratios[5:7].max() < 50.0

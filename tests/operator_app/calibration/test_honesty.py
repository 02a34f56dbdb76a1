"""Sigmas match errors on arms of the shop floor, in small; tests/benchmarks/honesty.py in full."""

import numpy as np
import pytest

from tests.benchmarks.shop_floor_files import read
from tests.benchmarks.shop_floor_outcome import NORMAL_95, outcome
from tests.oracles.shop_floor import PARAMETERS, SOURCES, Sizes, session
from tests.oracles.shop_floor_bound import bound

pytestmark = pytest.mark.campaign


def test_intervals_cover_the_truth_with_all_errors_as_stated():
    outcomes = [outcome(session(seed)) for seed in range(1100, 1106)]
    assert all(o.accepted for o in outcomes)
    z = np.array([o.z for o in outcomes])
    # 84 intervals of 6 arms, whose parameters correlate: a wide band.
    assert np.mean(np.abs(z) < NORMAL_95) >= 0.88
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.25


@pytest.mark.parametrize("source", SOURCES)
def test_intervals_cover_the_truth_with_one_error_source(source):
    sizes = Sizes.only(source)
    arm, fixture = read({}, sizes)
    z = [outcome(session(seed, sizes), arm=arm, fixture=fixture).z for seed in (1100, 1101, 1102)]
    assert np.mean(np.abs(z) < NORMAL_95) >= 0.85
    assert np.sqrt(np.mean(np.square(z))) < 1.6


def test_errors_are_near_the_bound():
    sizes = Sizes.only("lengths")
    arm, fixture = read({}, sizes)
    ratios = []
    for seed in range(1100, 1104):
        taken = session(seed, sizes)
        result = outcome(taken, arm=arm, fixture=fixture)
        ratios.append(result.error / bound(taken, sizes))
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_sigmas_of_many_poses_are_not_too_small():
    z = np.array([outcome(session(seed, poses=160)).z for seed in (1100, 1101, 1102)])
    assert z.shape == (3, len(PARAMETERS))
    assert np.sqrt(np.mean(z**2)) < 1.5

"""Tests of a fit fire as seldom as they state, whatever the poses determine."""

import numpy as np
import pytest

from solver.diagnostics.hypothesis_tests import HypothesisTest, pull_tests
from tests.oracles.as_shipped import SEED, fit_of
from tests.oracles.shop_floor import session

DRAWS = 200_000


@pytest.mark.parametrize("poses", [12, 40])
@pytest.mark.parametrize("false_alarm", [1e-3, 0.1])
def test_correlated_pulls_keep_the_false_alarm_rate(poses, false_alarm):
    """Few poses determine sums of lengths: their pulls rise and fall together, and so do their squares."""
    stated = fit_of(session(SEED, poses=poses)).linear.stated
    test = next(t for t in pull_tests(stated, false_alarm) if t.code == "PULLS")
    design, flat = stated.design, stated.design.flat_count
    names = [n for g in design.groups if g.source in ("lengths", "twists") for n in g.names]
    own = [k for k, name in enumerate(names) if name in design.errors.tolerance]
    assert test.statistic == pytest.approx(float((stated.pulls[own] ** 2).sum()))
    # An effect with variance 1, as predicted from data: its covariance is what the data take from that variance.
    determined = np.eye(len(own)) - np.linalg.inv(stated.H)[np.ix_(*[[flat + k for k in own]] * 2)]
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(len(own)), determined, DRAWS)
    squares = (draws**2 / np.diagonal(determined)).sum(-1)
    assert float(np.mean(squares > test.threshold)) == pytest.approx(false_alarm, rel=0.5)


def test_independent_squares_are_chi2_distributed():
    z = np.array([1.0, -2.0, 0.5])
    squares = HypothesisTest.of_squares("SQUARES", z, np.eye(3))
    chi2 = HypothesisTest.of_chi2("SQUARES", 5.25, 3)
    assert squares.statistic == chi2.statistic
    assert squares.threshold == pytest.approx(chi2.threshold)


def test_deviations_of_either_sign_count():
    test = HypothesisTest.of_sigmas("SIGMAS", np.array([-9.0, 1.0]))
    assert test.statistic == 9.0
    assert test.fires
    assert HypothesisTest.of_sigmas("SIGMAS", np.array([np.nan, 1.0])).fires

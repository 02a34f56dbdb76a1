"""A step of the variances, where the likelihood is given."""

from types import SimpleNamespace

import numpy as np

from solver.estimators.likelihood import Derivatives
from solver.estimators.scoring import ScoringStep, VarianceSearch, step


def fit_of(v: list[float]) -> SimpleNamespace:
    each = np.ones(len(v))
    design = SimpleNamespace(
        floors=0.01 * each, ceilings=1e6 * each, raise_limits=0.0 * each, scaled=each < 0
    )
    return SimpleNamespace(v=np.array(v), design=design)


def found(score: list[float], information: list[list[float]]) -> Derivatives:
    known = np.array(information)
    return Derivatives(
        score=np.array(score), information=known, curvature=known, expected=np.zeros(len(score))
    )


def test_a_step_is_newtons_where_nothing_bounds_it():
    taken = step(fit_of([1.0, 1.0]), found([0.2, -0.1], [[2.0, 0.5], [0.5, 1.0]]))
    expected = np.linalg.solve([[2.0, 0.5], [0.5, 1.0]], [0.2, -0.1])
    np.testing.assert_allclose(taken.change, expected, rtol=1e-6)


def test_a_variance_of_which_nothing_is_told_stays_and_the_others_move():
    """Rounding may leave less than nothing on the diagonal, and something beside it."""
    for nothing in (0.0, -1e-9):
        taken = step(fit_of([1.0, 1.0]), found([0.2, 0.3], [[2.0, 1e10], [1e10, nothing]]))
        np.testing.assert_allclose(taken.change, [0.1, 0.0], rtol=1e-6)


def steps_away(ascent: VarianceSearch, *largest: float) -> list[bool]:
    """What an ascent says of its pace after steps so large, in standard errors, are wanted one after the other."""
    said = []
    for size in largest:
        wanted = ScoringStep(change=np.zeros(2), largest=size, slope=0.0)
        fit = SimpleNamespace(v=np.ones(2), log_likelihood=0.0)
        ascent.next_variances(fit, found([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]]), wanted, far=False)
        said.append(ascent.fast)
    return said


def test_an_ascent_is_fast_where_its_steps_shrink_fast():
    assert steps_away(VarianceSearch(), 1.0, 0.2, 0.03, 0.02) == [False, True, True, False]


def test_steps_of_two_likelihoods_are_not_compared_and_the_pace_of_the_first_holds():
    """Where gravity's sign goes the first step of the new likelihood took another round for nothing."""
    assert steps_away(VarianceSearch(fast=True), 0.5, 0.4) == [True, False]
    assert steps_away(VarianceSearch(fast=False), 0.5, 0.1) == [False, True]

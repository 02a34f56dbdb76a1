"""A step of the variances, where the likelihood is given."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from solver.estimators.likelihood import Derivatives
from solver.estimators.scoring import step


def fit_of(v: list[float]) -> SimpleNamespace:
    each = np.ones(len(v))
    design = SimpleNamespace(floors=0.01 * each, walls=1e6 * each, leaps=0.0 * each)
    return SimpleNamespace(v=np.array(v), design=design)


def found(score: list[float], information: list[list[float]]) -> Derivatives:
    known = np.array(information)
    return Derivatives(
        score=np.array(score), information=known, curvature=known, expected=np.zeros(len(score))
    )


def test_a_step_is_newtons_where_nothing_bounds_it() -> None:
    taken = step(fit_of([1.0, 1.0]), found([0.2, -0.1], [[2.0, 0.5], [0.5, 1.0]]))
    expected = np.linalg.solve([[2.0, 0.5], [0.5, 1.0]], [0.2, -0.1])
    np.testing.assert_allclose(taken.change, expected, rtol=1e-6)


def test_a_variance_of_which_nothing_is_told_stays_and_the_others_move() -> None:
    """Rounding may leave less than nothing on the diagonal, and something beside it."""
    for nothing in (0.0, -1e-9):
        taken = step(fit_of([1.0, 1.0]), found([0.2, 0.3], [[2.0, 1e10], [1e10, nothing]]))
        np.testing.assert_allclose(taken.change, [0.1, 0.0], rtol=1e-6)

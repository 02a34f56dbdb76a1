"""A step of the variances, where the likelihood is given."""

from types import SimpleNamespace

import numpy as np

from solver.estimators.scoring import (
    SCALE_CORRELATION,
    SCALE_SD,
    Derivatives,
    step,
    with_priors,
)


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


def test_an_unbounded_step_is_newtons():
    taken = step(fit_of([1.0, 1.0]), found([0.2, -0.1], [[2.0, 0.5], [0.5, 1.0]]))
    expected = np.linalg.solve([[2.0, 0.5], [0.5, 1.0]], [0.2, -0.1])
    np.testing.assert_allclose(taken.change, expected, rtol=1e-6)


def test_an_undetermined_variance_stays_and_the_others_move():
    """Rounding may leave less than nothing on the diagonal, and something beside it."""
    for nothing in (0.0, -1e-9):
        taken = step(fit_of([1.0, 1.0]), found([0.2, 0.3], [[2.0, 1e10], [1e10, nothing]]))
        np.testing.assert_allclose(taken.change, [0.1, 0.0], rtol=1e-6)


def scales_at(t: list[float]) -> SimpleNamespace:
    """Two scales of the arm and one of the fixture's placement, exp(t), of which the poses show nothing."""
    each = np.ones(len(t))
    plain = SimpleNamespace(spread_dof=0.0, spread_variance=0.0, soft=np.inf)
    design = SimpleNamespace(
        scaled=each > 0, index={"sag": 0, "lengths": 1, "placement": 2}, components=[plain] * len(t),
        start_variances=lambda: each,
    )  # fmt: skip
    nothing = np.zeros((len(t),) * 2)
    unseen = Derivatives(score=0.0 * each, information=nothing, curvature=nothing, expected=each)
    return SimpleNamespace(v=np.exp(2.0 * np.array(t)), derivatives=unseen, design=design)


def test_log_scales_are_normal_with_half_of_the_variance_in_common():
    t, c = np.array([-0.7, 0.2, 0.9]), SCALE_CORRELATION
    covariance = SCALE_SD**2 * np.array([[1.0, c, 0.0], [c, 1.0, 0.0], [0.0, 0.0, 1.0]])
    fit = scales_at(t.tolist())

    def score(v):
        """Of the density by v, ``t = log(v) / 2``."""
        return -np.linalg.solve(covariance, 0.5 * np.log(v)) / (2.0 * v)

    prior = with_priors(fit)
    np.testing.assert_allclose(prior.score, score(fit.v), rtol=1e-9)
    steps = 1e-6 * np.diag(fit.v)
    observed = [(score(fit.v - h) - score(fit.v + h)) / (2.0 * h.sum()) for h in steps]
    np.testing.assert_allclose(prior.curvature, observed, rtol=1e-6)
    expected = np.linalg.inv(covariance) / (4.0 * np.outer(fit.v, fit.v))
    np.testing.assert_allclose(prior.information, expected, rtol=1e-9, atol=1e-15)

"""Steps of the variances for given derivatives of the likelihood, and the prior of scales."""

from types import SimpleNamespace

import numpy as np
import pytest

from solver.estimators.scoring import (
    LARGEST_COMMON,
    SCALE_CORRELATION,
    SCALE_SD,
    Derivatives,
    ScoringStep,
    VarianceSearch,
    step,
    with_priors,
)


def fit_of(v: list[float]) -> SimpleNamespace:
    each = np.ones(len(v))
    design = SimpleNamespace(
        floors=0.01 * each, ceilings=1e6 * each, raise_limits=0.0 * each, scaled=each < 0
    )
    return SimpleNamespace(v=np.array(v), design=design)


def derivatives(score: list[float], information: list[list[float]]) -> Derivatives:
    known = np.array(information)
    return Derivatives(
        score=np.array(score), information=known, curvature=known, expected=np.zeros(len(score))
    )


def test_an_unbounded_step_is_newtons():
    taken = step(fit_of([1.0, 1.0]), derivatives([0.2, -0.1], [[2.0, 0.5], [0.5, 1.0]]))
    expected = np.linalg.solve([[2.0, 0.5], [0.5, 1.0]], [0.2, -0.1])
    np.testing.assert_allclose(taken.change, expected, rtol=1e-6)


def test_an_undetermined_variance_stays_and_the_others_move():
    """Rounding may leave a negative number on the diagonal, and a large one beside it."""
    for nothing in (0.0, -1e-9):
        taken = step(fit_of([1.0, 1.0]), derivatives([0.2, 0.3], [[2.0, 1e10], [1e10, nothing]]))
        np.testing.assert_allclose(taken.change, [0.1, 0.0], rtol=1e-6)


@pytest.mark.parametrize("way", [-np.inf, np.inf])
def test_a_variance_at_its_bound_but_for_rounding_stays_there(way: float):
    """Its likelihood is larger beyond the bound, but a step that includes it would move it inwards."""
    sign = 1.0 if way > 0.0 else -1.0
    bound = 0.01 if way > 0.0 else 1e6
    told = derivatives([0.5 * sign, -0.1 * sign], [[2.0, -1.9], [-1.9, 2.0]])
    for v in (bound, np.nextafter(bound, way)):
        taken = step(fit_of([5e5, v]), told)
        np.testing.assert_allclose(taken.change, [0.25 * sign, 0.0], rtol=1e-6, atol=1e-9)


def test_slope_after_a_step_falls_with_the_square_of_steps_that_shrink_fast():
    ascent = VarianceSearch()
    left = []
    for size, slope in ((1.0, 4.0), (0.2, 1.0), (0.1, 0.5)):
        proposed = ScoringStep(change=np.zeros(2), largest=size, slope=slope)
        fit = SimpleNamespace(v=np.ones(2), log_likelihood=0.0)
        ascent.next_variances(
            fit, derivatives([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]]), proposed, far=True
        )
        left.append(ascent.slope_left)
    np.testing.assert_allclose(left, [4.0, 0.04, 0.5])


NAMES = ("sag", "encoder_accuracy", "lengths", "twists", "placement")
GROUPS = (slice(0, 2), slice(2, 4))


def scales_at(t: list[float], names=NAMES) -> SimpleNamespace:
    """Scales exp(t) of what moves, of the links and of the fixture's placement, of which the poses show nothing."""
    each = np.ones(len(t))
    plain = SimpleNamespace(spread_dof=0.0, spread_variance=0.0, prior_scale=np.inf)
    design = SimpleNamespace(
        scaled=each > 0, index={name: k for k, name in enumerate(names)}, components=[plain] * len(t),
        start_variances=lambda: each,
    )  # fmt: skip
    nothing = np.zeros((len(t),) * 2)
    unseen = Derivatives(score=0.0 * each, information=nothing, curvature=nothing, expected=each)
    return SimpleNamespace(v=np.exp(2.0 * np.array(t)), derivatives=unseen, design=design)


def energy(t):
    """Minus the log density of the log scales: two of either group, with a common part, and the placement's."""
    c, largest = SCALE_CORRELATION, LARGEST_COMMON
    own = t @ (t / np.array([*[1.0 - c] * 4, 1.0]))
    common = sum((largest * np.tanh(t[group] / largest)).sum() ** 2 for group in GROUPS)
    return 0.5 * (own - c / ((1.0 + c) * (1.0 - c)) * common) / SCALE_SD**2


@pytest.mark.parametrize(
    "t", [[-0.7, 0.2, 0.3, -0.4, 0.9], [-3.5, -0.1, 0.2, 1.1, 0.0], [1.4, -2.5, 0.7, -1.3, -1.0]]
)
def test_prior_of_scales_has_the_derivatives_of_its_density(t):
    fit = scales_at(t)

    def score(v):
        """Of the density by v, ``t = log(v) / 2``."""
        at = 0.5 * np.log(v)
        slope = [(energy(at + h) - energy(at - h)) / (2.0 * h.sum()) for h in 1e-5 * np.eye(5)]
        return -np.array(slope) / (2.0 * v)

    prior = with_priors(fit)
    np.testing.assert_allclose(prior.score, score(fit.v), rtol=1e-6, atol=1e-6)
    steps = 1e-4 * np.diag(fit.v)
    observed = [(score(fit.v - h) - score(fit.v + h)) / (2.0 * h.sum()) for h in steps]
    np.testing.assert_allclose(prior.curvature, observed, rtol=1e-3, atol=1e-3)


def test_log_scales_near_the_stated_ones_are_normal_with_half_of_the_variance_in_common():
    c, fit = SCALE_CORRELATION, scales_at([0.0] * 5)
    correlation = np.eye(5)
    for group in GROUPS:
        correlation[group, group] = [[1.0, c], [c, 1.0]]
    expected = 0.25 * np.linalg.inv(SCALE_SD**2 * correlation)
    np.testing.assert_allclose(with_priors(fit).information, expected, rtol=1e-9, atol=1e-15)


def test_absent_source_says_no_more_of_the_others_than_a_small_one():
    pull = [with_priors(scales_at([t, *[0.0] * 4])).score[1] for t in (-1.1, -2.5, -10.0)]
    assert pull[1] < pull[0] < 0.0
    # Normal variables would have made it four times as strong as that of a quarter (-2.5).
    assert 1.0 < pull[2] / pull[1] < 1.3


def test_joints_and_fixture_without_errors_say_nothing_of_the_links():
    """Otherwise sigmas of what only lengths limit are too small on an arm whose joints and fixture are exact."""
    names = (
        "sag",
        "joint_play",
        "encoder_accuracy",
        "fixture_m",
        "compliance",
        "lengths",
        "twists",
    )
    prior = with_priors(scales_at([-2.0] * 5 + [0.0] * 2, names))
    np.testing.assert_array_equal(prior.score[5:], 0.0)
    np.testing.assert_array_equal(prior.information[5:, :5], 0.0)


def test_single_scale_of_a_group_is_log_normal():
    for t in (-3.0, 0.5):
        prior = with_priors(scales_at([0.1, -0.2, t], ("sag", "joint_play", "lengths")))
        assert prior.score[2] * 2.0 * np.exp(2.0 * t) == pytest.approx(-t / SCALE_SD**2)

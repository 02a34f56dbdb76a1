"""Restricted likelihood against dense matrices, and variances recovered."""

from __future__ import annotations

import numpy as np
import pytest

from solver.estimators.reml import MixedModel, fit_reml, solve_mixed

POSES, ROWS, UNKNOWNS = 40, 5, 6
TRUE = np.array([4.0, 0.5, 2.0])


def simulated(seed: int, variances: np.ndarray = TRUE) -> MixedModel:
    """Rank-one noise, three-row noise and one effect of three columns, over a known floor."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(POSES, ROWS, UNKNOWNS))
    b = rng.normal(size=(POSES, ROWS, 1))
    Z = rng.normal(size=(POSES, ROWS, 3))
    rows = np.diag([0.0, 0.0, 1.0, 1.0, 1.0])
    root = np.sqrt(variances)
    w = -(A @ rng.normal(size=UNKNOWNS)) + 0.1 * rng.normal(size=(POSES, ROWS))
    w += root[0] * b[..., 0] * rng.normal(size=(POSES, 1))
    w += root[1] * rng.normal(size=(POSES, ROWS)) @ rows
    w += root[2] * Z @ rng.normal(size=3)
    return MixedModel(
        w=w,
        A=A,
        base=np.broadcast_to(0.01 * np.eye(ROWS), (POSES, ROWS, ROWS)),
        noise=(b @ np.swapaxes(b, 1, 2), np.broadcast_to(rows, (POSES, ROWS, ROWS))),
        effects=(Z,),
    )


def block_diagonal(blocks: np.ndarray) -> np.ndarray:
    out = np.zeros((POSES * ROWS, POSES * ROWS))
    for k, block in enumerate(blocks):
        out[k * ROWS : (k + 1) * ROWS, k * ROWS : (k + 1) * ROWS] = block
    return out


@pytest.mark.parametrize("variances", [TRUE, np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.3, 9.0])])
def test_everything_agrees_with_dense_matrices(variances: np.ndarray) -> None:
    model = simulated(0)
    A, w = model.A.reshape(-1, UNKNOWNS), model.w.reshape(-1)
    Z = model.effects[0].reshape(-1, 3)
    parts = [block_diagonal(c) for c in model.noise] + [Z @ Z.T]
    V = block_diagonal(model.base) + sum(v * p for v, p in zip(variances, parts, strict=True))
    W = np.linalg.inv(V)
    M = A.T @ W @ A
    P = W - W @ A @ np.linalg.solve(M, A.T @ W)
    found = solve_mixed(model, variances)
    log_det = np.linalg.slogdet(V)[1] + np.linalg.slogdet(M)[1]
    assert found.log_likelihood == pytest.approx(-0.5 * (log_det + w @ P @ w), rel=1e-10)
    assert found.chi2 == pytest.approx(w @ P @ w, rel=1e-10)
    for k, part in enumerate(parts):
        score = 0.5 * (w @ P @ part @ P @ w - np.trace(P @ part))
        assert found.score[k] == pytest.approx(score, rel=1e-7)
        for j, other in enumerate(parts):
            expected = 0.5 * np.trace(P @ part @ P @ other)
            observed = w @ P @ part @ P @ other @ P @ w - expected
            assert found.information[k, j] == pytest.approx(expected, rel=1e-4)
            assert found.curvature[k, j] == pytest.approx(observed, rel=1e-3, abs=1e-6)
    assert found.step == pytest.approx(-np.linalg.solve(M, A.T @ W @ w), rel=1e-9)
    assert found.effects[0] == pytest.approx(variances[2] * Z.T @ P @ w, rel=1e-8, abs=1e-12)
    assert found.covariance[:UNKNOWNS, :UNKNOWNS] == pytest.approx(np.linalg.inv(M), rel=1e-8)
    of_effects = variances[2] * np.eye(3) - variances[2] ** 2 * Z.T @ P @ Z
    assert found.covariance[UNKNOWNS:, UNKNOWNS:] == pytest.approx(of_effects, rel=1e-4, abs=1e-9)


def test_score_is_the_slope_of_the_likelihood() -> None:
    model = simulated(1)
    found = solve_mixed(model, TRUE)
    for k in range(3):
        h = 1e-5 * np.eye(3)[k]
        up, down = (solve_mixed(model, TRUE + s * h).log_likelihood for s in (1.0, -1.0))
        assert found.score[k] == pytest.approx((up - down) / 2e-5, rel=1e-4, abs=1e-6)


def test_maximum_is_reached_from_far_starts() -> None:
    model = simulated(2)
    fits = [fit_reml(model, np.array(start)) for start in ([1e-4] * 3, [100.0] * 3, [1.0, 0, 0])]
    for fit in fits:
        assert fit.converged
        assert fit.variances == pytest.approx(fits[0].variances, rel=1e-6)
        assert np.abs(fit.solution.score * fit.variances).max() < 1e-6


def test_variances_are_recovered_on_average() -> None:
    found = np.array([fit_reml(simulated(seed), TRUE).variances for seed in range(100)])
    error = found.std(axis=0) / np.sqrt(len(found))
    # REML is unbiased here but for the clip at zero, which these sizes never reach.
    assert np.abs((found.mean(axis=0) - TRUE) / error).max() < 4.0


def test_a_component_that_is_not_there_ends_at_zero_or_nearly() -> None:
    zeros = 0
    for seed in range(20):
        fit = fit_reml(simulated(seed, np.array([4.0, 0.0, 2.0])), TRUE)
        assert fit.converged
        assert fit.variances.min() >= 0.0
        assert fit.variances[1] < 0.01
        zeros += fit.variances[1] == 0.0
    # On the boundary half the estimates are zero: 20 of 20 or none has a chance of 1e-6 each.
    assert 0 < zeros < 20


def test_held_components_stay() -> None:
    held = np.array([False, True, False])
    fit = fit_reml(simulated(3), np.array([1.0, 0.25, 1.0]), held=held)
    assert fit.variances[1] == 0.25
    assert fit.variances[0] != 1.0
    everything = fit_reml(simulated(3), TRUE, held=np.ones(3, dtype=bool))
    assert everything.converged
    assert np.array_equal(everything.variances, TRUE)

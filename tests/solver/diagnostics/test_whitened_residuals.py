"""Whitened residuals, against least squares with the further columns."""

from dataclasses import replace

import numpy as np
import pytest

from solver.diagnostics.fault_models import Candidate, Cause
from solver.diagnostics.hypothesis_tests import find_outliers
from solver.diagnostics.model_selection import evidence, log_likelihood, noise_scale, probabilities
from solver.diagnostics.whitened_residuals import PoseNoise, WhitenedResiduals
from tests.oracles.fit_residuals import fit_residuals

POSES, ROWS, UNKNOWNS = 30, 4, 6


def problem(seed: int):
    """A system with correlated noise: w, A, V and further columns."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(POSES, ROWS, UNKNOWNS))
    root = np.eye(ROWS) + 0.3 * np.tril(rng.normal(size=(POSES, ROWS, ROWS)), -1)
    V = root @ np.swapaxes(root, -1, -2)
    w = (root @ rng.normal(size=(POSES, ROWS, 1)))[..., 0]
    return w, A, V, rng.normal(size=(POSES, ROWS, 3))


def dense(V: np.ndarray) -> np.ndarray:
    whole = np.zeros((POSES * ROWS, POSES * ROWS))
    for k, block in enumerate(V):
        whole[k * ROWS : (k + 1) * ROWS, k * ROWS : (k + 1) * ROWS] = block
    return whole


def projector(V: np.ndarray, X: np.ndarray) -> np.ndarray:
    """V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1, multiplied out."""
    W = np.linalg.inv(V)
    return W - W @ X @ np.linalg.inv(X.T @ W @ X) @ X.T @ W


def written_out(m: int, own: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Blocks (k, r, c) of poses `own` (k,) as columns (m, r, k c) of all poses."""
    out = np.zeros((m, ROWS, len(own), blocks.shape[-1]))
    out[own, :, np.arange(len(own)), :] = blocks
    return out.reshape(m, ROWS, -1)


def pose_columns(left: WhitenedResiduals, poses: np.ndarray) -> np.ndarray:
    """Columns (p, r, r), one for each equation of the poses (p,), in units of noise."""
    return np.linalg.inv(left.whitener[poses])


def fault(columns: np.ndarray, size: np.ndarray, own: np.ndarray | None = None) -> Candidate:
    at = {"columns": columns, "own": own}
    return Candidate(cause=Cause.OUTLIERS, subject="", expected_size=size, most=np.inf, **at)


def covariance(left: WhitenedResiduals) -> np.ndarray:
    """Of the parameters."""
    return left.to_x @ left.to_x.T


def test_random_effects_and_priors_are_in_the_covariance():
    w, A, V, G = problem(2)
    rng = np.random.default_rng(3)
    Z = rng.normal(size=(POSES, ROWS, 5))
    prior = np.full(UNKNOWNS, np.inf)
    prior[[1, 4]] = 0.3, 2.0
    flat = Z.reshape(-1, 5)
    soft = A.reshape(-1, UNKNOWNS)[:, [1, 4]] * (0.3, 2.0)
    whole = dense(V) + flat @ flat.T + soft @ soft.T
    P, y = projector(whole, A.reshape(-1, UNKNOWNS)[:, [0, 2, 3, 5]]), w.reshape(-1)
    left = fit_residuals(w, A, V, prior_sd=prior).with_columns(Z, np.ones(5))
    assert left.chi2 == pytest.approx(y @ P @ y)
    s, C = left.score(G)
    np.testing.assert_allclose(s, G.reshape(-1, 3).T @ P @ y, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(C, G.reshape(-1, 3).T @ P @ G.reshape(-1, 3), rtol=1e-8, atol=1e-9)
    columns = np.concatenate((A, Z), axis=-1).reshape(len(y), -1)
    information = columns.T @ np.linalg.inv(dense(V)) @ columns + np.diag([*prior**-2, *np.ones(5)])
    expected = np.linalg.inv(information)[:UNKNOWNS, :UNKNOWNS]
    np.testing.assert_allclose(covariance(left), expected, rtol=1e-8, atol=1e-12)


def test_added_columns_equal_fitted_columns():
    w, A, V, G = problem(4)
    once = fit_residuals(w, np.concatenate((A, G), axis=-1), V)
    later = fit_residuals(w, A, V).with_columns(G)
    assert later.chi2 == pytest.approx(once.chi2)
    assert later.dof == once.dof
    np.testing.assert_allclose(later.white, once.white, atol=1e-9)
    np.testing.assert_allclose(
        covariance(later), covariance(once)[:UNKNOWNS, :UNKNOWNS], rtol=1e-8, atol=1e-12
    )


def test_parameters_move_as_in_a_fit_with_the_columns():
    w, A, V, G = problem(5)
    P = np.linalg.inv(dense(V))

    def solution(X: np.ndarray) -> np.ndarray:
        return -np.linalg.solve(X.T @ P @ X, X.T @ P @ w.reshape(-1))

    before = solution(A.reshape(-1, UNKNOWNS))
    after = solution(np.concatenate((A, G), axis=-1).reshape(-1, UNKNOWNS + 3))
    left = fit_residuals(w, A, V)
    moved = left.moved(G, -after[UNKNOWNS:])
    np.testing.assert_allclose(moved, after[:UNKNOWNS] - before, rtol=1e-8, atol=1e-10)


def test_outliers_do_not_mask_each_other():
    w, A, V, _ = problem(6)
    assert find_outliers(fit_residuals(w, A, V)).poses == ()
    for poses in ((7,), (3, 11, 20)):
        disturbed = w.copy()
        disturbed[list(poses)] += 9.0
        result = find_outliers(fit_residuals(disturbed, A, V))
        assert sorted(result.poses) == sorted(poses)
        assert result.test.fires
        assert result.rest.chi2 < result.rest.dof * 2.0


def test_excluded_poses_equal_poses_with_own_columns():
    """Only pose 9 determines the last unknown; without it there is no division by zero."""
    w, A, V, G = problem(10)
    A = np.concatenate((A, np.zeros((POSES, ROWS, 1))), axis=-1)
    A[9, :, -1] = 1.0
    left = fit_residuals(w, A, V)
    poses = np.array([4, 9])
    there, fitted = (
        left.without(poses),
        left.with_columns(written_out(POSES, poses, pose_columns(left, poses))),
    )
    assert there.U.shape == left.U.shape
    assert there.dof == fitted.dof
    assert there.chi2 == pytest.approx(fitted.chi2)
    np.testing.assert_allclose(there.white, fitted.white, atol=1e-9)
    for a, b in zip(there.score(G), fitted.score(G), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(covariance(there), covariance(fitted), rtol=1e-8, atol=1e-12)
    one_by_one = left.without(poses[:1]).without(poses[1:])
    np.testing.assert_allclose(one_by_one.white, there.white, atol=1e-9)


def test_many_outliers_are_found_in_few_rounds(monkeypatch):
    """Several are excluded at a time."""
    m = 1000
    rng = np.random.default_rng(11)
    A, w = rng.normal(size=(m, ROWS, UNKNOWNS)), rng.normal(size=(m, ROWS))
    poses = rng.permutation(m)[:250]
    w[poses] += 9.0 * (1.0 + rng.random((250, 1)))
    left = fit_residuals(w, A, np.tile(np.eye(ROWS), (m, 1, 1)))
    rounds, without = [], WhitenedResiduals.without
    monkeypatch.setattr(
        WhitenedResiduals, "without", lambda *excluded: rounds.append(0) or without(*excluded)
    )
    result = find_outliers(left)
    assert sorted(result.poses) == sorted(poses)
    assert result.rest.U.shape == left.U.shape
    assert 80 <= len(rounds) <= 110


def test_a_sound_pose_set_rarely_has_an_outlier():
    rng = np.random.default_rng(8)
    _, A, V, _ = problem(7)
    root = np.linalg.cholesky(V)
    alarms = 0
    for _ in range(600):
        w = (root @ rng.normal(size=(POSES, ROWS, 1)))[..., 0]
        result = find_outliers(fit_residuals(w, A, V))
        alarms += bool(result.poses)
    assert alarms <= 5


def test_evidence_prefers_the_true_cause():
    """A common shift along one column against the same column free in every pose."""
    w, A, V, G = problem(9)
    one = G[..., :1]
    each = np.repeat(np.eye(POSES)[:, None, :], ROWS, axis=1) * one
    left = fit_residuals(w + 3.0 * one[..., 0], A, V)
    faults = fault(one, np.ones(1)), fault(each, np.ones(POSES))
    right, lavish = (evidence(left, candidate) for candidate in faults)
    assert right is not None
    assert lavish is not None
    assert right.log_likelihood > lavish.log_likelihood + 5.0
    assert right.log_likelihood > log_likelihood(left.chi2, left.dof) + 5.0
    assert right.b[0] == pytest.approx(3.0, abs=5.0 * np.sqrt(right.covariance[0, 0]))
    np.testing.assert_allclose(probabilities(np.array([0.0, np.log(3.0)])), [0.25, 0.75])


def test_evidence_prefers_no_fault_for_sound_poses():
    w, A, V, G = problem(10)
    left = fit_residuals(w, A, V)
    result = evidence(left, fault(G, np.ones(3)))
    assert result is not None
    assert log_likelihood(left.chi2, left.dof) > result.log_likelihood - 1.0
    assert 0.25 <= noise_scale(left.chi2, left.dof) <= 1.0


def test_columns_already_fitted_give_no_evidence():
    w, A, V, _ = problem(11)
    assert evidence(fit_residuals(w, A, V), fault(A[..., :2], np.ones(2))) is None


MORE_POSES = 40


@pytest.fixture(scope="module")
def left():
    rng = np.random.default_rng(12)
    A = rng.normal(size=(MORE_POSES, ROWS, UNKNOWNS))
    V = np.eye(ROWS) + np.full((ROWS, ROWS), 0.3)
    w = rng.normal(size=(MORE_POSES, ROWS))
    w[[3, 20]] += 6.0
    prior = np.where(np.arange(UNKNOWNS) == 2, 0.5, np.inf)
    result = fit_residuals(w, A, np.broadcast_to(V, (MORE_POSES, ROWS, ROWS)), prior_sd=prior)
    return replace(result, whitener=np.array(result.whitener))


@pytest.mark.parametrize(("count", "width"), [(1, 4), (3, 2), (30, 1), (40, 3)])
def test_evidence_equals_that_of_explicit_columns(left, count, width):
    rng = np.random.default_rng(count)
    own = np.sort(rng.choice(MORE_POSES, count, replace=False))
    blocks = rng.normal(size=(count, ROWS, width))
    expected_size = np.tile(rng.uniform(0.5, 2.0, width), count)
    there = evidence(left, fault(written_out(MORE_POSES, own, blocks), expected_size))
    here = evidence(left, fault(blocks, expected_size, own))
    assert there is not None
    assert here is not None
    assert here.log_likelihood == pytest.approx(there.log_likelihood)
    assert (here.size, here.dof) == (there.size, there.dof)
    assert here.chi2 == pytest.approx(there.chi2)
    np.testing.assert_allclose(here.b, there.b, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(here.covariance, np.diagonal(there.covariance), rtol=1e-7)
    np.testing.assert_allclose(here.moved, there.moved, rtol=1e-7, atol=1e-10)


def test_random_columns_count_as_noise_of_their_poses(left):
    """Whitened again, with the same scores as with columns that are fitted."""
    rng = np.random.default_rng(7)
    own, other = np.array([3, 20, 31]), rng.normal(size=(MORE_POSES, ROWS, 2))
    blocks = 5.0 * pose_columns(left, own)
    there = left.with_columns(written_out(MORE_POSES, own, blocks), np.ones(len(own) * ROWS))
    here = PoseNoise(left, own, blocks).residuals()
    assert here.U.shape == left.U.shape
    assert here.chi2 == pytest.approx(there.chi2)
    np.testing.assert_allclose(covariance(here), covariance(there), rtol=1e-8, atol=1e-12)
    for one, two in zip(here.score(other), there.score(other), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-8, atol=1e-9)
    b = np.array([0.3, -0.2])
    np.testing.assert_allclose(here.moved(other, b), there.moved(other, b), rtol=1e-8, atol=1e-10)


def test_a_thousand_outliers_need_no_dense_columns():
    """All columns together would have 1.2 GB."""
    import tracemalloc

    rng = np.random.default_rng(3)
    m, r = 3000, 5
    A, w = rng.normal(size=(m, r, 10)), rng.normal(size=(m, r))
    eye = np.broadcast_to(np.eye(r), (m, r, r))
    left, own = fit_residuals(w, A, eye), np.arange(0, m, 3)
    tracemalloc.start()
    result = evidence(left, fault(pose_columns(left, own), np.full(len(own) * r, 3.0), own))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert result is not None
    assert peak < 12e6

"""Columns of poses of their own: against the same columns written out, most of them zeros."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver.diagnostics.model_selection import evidence, evidence_of_own
from solver.diagnostics.outliers import pose_columns
from solver.diagnostics.pose_columns import OwnColumns
from solver.diagnostics.whitened_residuals import LeftOver, left_over

POSES, ROWS, UNKNOWNS = 40, 4, 6


@pytest.fixture(scope="module")
def left() -> LeftOver:
    rng = np.random.default_rng(12)
    A = rng.normal(size=(POSES, ROWS, UNKNOWNS))
    V = np.eye(ROWS) + np.full((ROWS, ROWS), 0.3)
    w = rng.normal(size=(POSES, ROWS))
    w[[3, 20]] += 6.0
    prior = np.where(np.arange(UNKNOWNS) == 2, 0.5, np.inf)
    found = left_over(w, A, np.broadcast_to(V, (POSES, ROWS, ROWS)), prior_sd=prior)
    return replace(found, whitener=np.array(found.whitener))


def written_out(own: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    out = np.zeros((POSES, ROWS, len(own), blocks.shape[-1]))
    out[own, :, np.arange(len(own)), :] = blocks
    return out.reshape(POSES, ROWS, -1)


@pytest.mark.parametrize(("count", "width"), [(1, 4), (3, 2), (30, 1), (40, 3)])
def test_evidence_is_that_of_the_columns_written_out(left, count, width) -> None:
    rng = np.random.default_rng(count)
    own = np.sort(rng.choice(POSES, count, replace=False))
    blocks = rng.normal(size=(count, ROWS, width))
    natural = np.tile(rng.uniform(0.5, 2.0, width), count)
    there = evidence(left, written_out(own, blocks), natural)
    here = evidence_of_own(left, own, blocks, natural)
    assert there is not None
    assert here is not None
    assert here.log_likelihood == pytest.approx(there.log_likelihood)
    assert (here.size, here.dof) == (there.size, there.dof)
    assert here.chi2 == pytest.approx(there.chi2)
    np.testing.assert_allclose(here.b, there.b, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(here.covariance, np.diagonal(there.covariance), rtol=1e-7)
    np.testing.assert_allclose(here.moved, there.moved, rtol=1e-7, atol=1e-10)


def test_what_is_drawn_is_noise_of_its_poses(left) -> None:
    """Whitened anew, and yet every question has the answer it has with the columns beside the others."""
    rng = np.random.default_rng(7)
    own, other = np.array([3, 20, 31]), rng.normal(size=(POSES, ROWS, 2))
    blocks = 5.0 * pose_columns(left, own)
    there = left.also_drawn(written_out(own, blocks), np.ones(len(own) * ROWS))
    here = OwnColumns.of(left, own, blocks).drawn(left)
    assert here.U.shape == left.U.shape
    assert here.chi2 == pytest.approx(there.chi2)
    np.testing.assert_allclose(here.covariance, there.covariance, rtol=1e-8, atol=1e-12)
    for one, two in zip(here.score(other), there.score(other), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-8, atol=1e-9)
    b = np.array([0.3, -0.2])
    np.testing.assert_allclose(here.moved(other, b), there.moved(other, b), rtol=1e-8, atol=1e-10)


def test_a_thousand_odd_poses_need_no_columns_of_all_poses() -> None:
    """Written out they are 1.2 GB; what is needed for them is a hundredth of that."""
    import tracemalloc

    rng = np.random.default_rng(3)
    m, r = 3000, 5
    A, w = rng.normal(size=(m, r, 10)), rng.normal(size=(m, r))
    eye = np.broadcast_to(np.eye(r), (m, r, r))
    left, own = left_over(w, A, eye), np.arange(0, m, 3)
    tracemalloc.start()
    found = evidence_of_own(left, own, pose_columns(left, own), np.full(len(own) * r, 3.0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found is not None
    assert peak < 12e6

"""What poses see by the equations of a fit is what they see on closed loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver.diagnostics.identifiability import Identifiability, identifiability, judge_jacobian
from solver.diagnostics.information import seen_by_fit
from solver.estimators.error_model import ErrorModel
from solver.estimators.mixed_fit import expected_fit
from tests.oracles.loop_oracle import Truth
from tests.solver.conftest import NAMES, loop_of, read_poses


@pytest.mark.parametrize("without", [(), (6, 7)])
def test_the_same_as_on_closed_loops(
    hinge_data: Path, truth: Truth, without: tuple[int, ...]
) -> None:
    q = read_poses(hinge_data / "hinge_exact.csv")[:40]
    names = tuple(n for n in NAMES if n not in {f"theta_off_{j}" for j in without})
    x = truth.values(NAMES)
    errors = ErrorModel(joint_variance=np.full(q.shape, 1e-10))
    order = np.random.default_rng(1).permutation(len(q))
    fit = expected_fit(loop_of(truth), q[order], errors, x)
    found = seen_by_fit(fit, names, taken=order, without=without)
    blind = loop_of(truth, unsensed=without)
    there = identifiability(blind, np.array([x[NAMES.index(p.name)] for p in blind.parameters]), q)
    assert found.rank == there.rank == len(names)
    assert found.scaled_condition_number == pytest.approx(there.scaled_condition_number, rel=1e-6)
    assert found.condition_number == pytest.approx(there.condition_number, rel=1e-6)
    assert found.weakest.parameters == there.weakest.parameters
    assert [n for n, _ in found.trend] == [n for n, _ in there.trend]
    assert [c for _, c in found.trend] == pytest.approx([c for _, c in there.trend], rel=1e-6)


def test_rows_triangularised_in_blocks_are_judged_as_the_whole() -> None:
    rng = np.random.default_rng(3)
    J = rng.normal(size=(600, 5, 6)) * 10.0 ** np.arange(-3, 3)
    J[..., 4] = 2.0 * J[..., 1]
    J[..., 5] = 0.0
    names = ("a", "b", "c", "d", "e", "f")

    def named(found: Identifiability) -> set[frozenset[str]]:
        return {frozenset(d.parameters) for d in found.directions}

    whole = judge_jacobian(J.reshape(-1, 6), names, poses=600)
    parts = judge_jacobian(np.linalg.qr(J.reshape(-1, 6), mode="r"), names, poses=600)
    assert parts.rank == whole.rank == 4
    assert named(parts) == named(whole)
    assert parts.observability == pytest.approx(whole.observability, rel=1e-9, abs=1e-12)

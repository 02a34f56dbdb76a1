"""Condition, rank and what cannot be seen, by name."""

import numpy as np
import pytest

from solver.diagnostics.identifiability import (
    condition_at_readings,
    identifiability,
    identifiability_of_fit,
    identifiability_of_jacobian,
    well_conditioned_at_readings,
)
from solver.estimators.error_model import ErrorModel
from solver.estimators.mixed_fit import expected_fit
from solver.estimators.paper import estimate_paper
from tests.oracles.loop_oracle import Truth, closed_poses, closure, closure_rates, product
from tests.solver.conftest import NAMES, loop_of, read_poses

MOVING = np.repeat(np.arange(8.0)[:, None], 7, axis=1)
"""Poses in which all joints move."""


def test_condition_at_the_readings_follows_the_papers_closure(truth):
    """Eqs. 10 to 13 by a second implementation, differenced, where the loops are open by milliradians."""
    random = np.random.default_rng(2)
    q = closed_poses(truth, random, 30)[:, 1:] + random.normal(0.0, 6e-3, (30, 7))

    def open_loops(at: Truth) -> np.ndarray:
        angles = np.concatenate((np.zeros((30, 1)), q), axis=1)
        T = product(angles + at.theta_off, at.s, at.a, at.alpha)
        angles[:, 0] = -np.arctan2(T[:, 1, 0], T[:, 0, 0])
        return np.delete(closure(at, angles), 2, axis=1)

    columns, values, h = [], truth.values(NAMES), 1e-6
    for k in range(14):
        step = h * np.eye(14)[k]
        up, down = (open_loops(truth.with_values(NAMES, values + s)) for s in (step, -step))
        columns.append(((up - down) / (2.0 * h)).ravel())
    J = np.stack(columns, axis=-1)
    s = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    result = condition_at_readings(loop_of(truth), values, q)
    assert result == pytest.approx(s[0] / s[-1], rel=2e-3)
    closed = identifiability(loop_of(truth), values, q).scaled_condition_number
    assert abs(closed / result - 1.0) > 0.008


def test_noise_does_not_make_unidentifiable_parameters_identifiable(truth):
    """Two poses have ten equations for fourteen unknowns, however often they are read."""
    random = np.random.default_rng(3)
    model, x = loop_of(truth), truth.values(NAMES)
    many = closed_poses(truth, random, 30)[:, 1:]
    again = many[np.arange(30) % 2] + random.normal(0.0, 10e-3, (30, 7))
    assert np.isfinite(condition_at_readings(model, x, again))
    assert not well_conditioned_at_readings(estimate_paper(model, again, x0=x), again)
    noisy = many + random.normal(0.0, 10e-3, many.shape)
    assert well_conditioned_at_readings(estimate_paper(model, noisy, x0=x), noisy)
    still = many.copy()
    still[:, 2] = many[0, 2]
    assert condition_at_readings(model, x, still) < 100.0
    assert not well_conditioned_at_readings(estimate_paper(model, still, x0=x), still)


def test_condition_and_observability_agree_with_a_second_implementation(truth):
    closed = closed_poses(truth, np.random.default_rng(1), 30)
    result = identifiability(loop_of(truth), truth.values(NAMES), closed[:, 1:])
    _, by_name = closure_rates(truth, closed, NAMES)
    # At closure the hinge moves the third row only.
    J = np.delete(by_name, 2, axis=1).reshape(-1, 14)
    s = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    plain = np.linalg.svd(J, compute_uv=False)
    assert result.scaled_condition_number == pytest.approx(s[0] / s[-1], rel=1e-8)
    assert result.condition_number == pytest.approx(plain[0] / plain[-1], rel=1e-8)
    expected = (
        np.prod(s) ** (1 / 14) / np.sqrt(30),
        s[-1] / s[0],
        s[-1],
        s[-1] ** 2 / s[0],
        1.0 / (1.0 / s).sum(),
    )
    assert result.observability == pytest.approx(expected, rel=1e-8)


def test_independent_unidentifiable_directions_are_listed_separately():
    J = np.random.default_rng(8).normal(size=(40, 5))
    J[:, 1] = 0.0
    J[:, 4] = 2.0 * J[:, 3]
    result = identifiability_of_jacobian(J.reshape(8, 5, 5), "pqrst", MOVING)
    assert result.rank == 3
    assert result.scaled_condition_number == np.inf
    assert {frozenset(d.parameters) for d in result.directions} == {
        frozenset({"q"}),
        frozenset({"s", "t"}),
    }
    texts = {str(d) for d in result.directions}
    assert "q cannot be determined" in texts


def test_fewer_rows_than_parameters_are_handled():
    result = identifiability_of_jacobian(np.eye(5)[:3, None], "pqrst", MOVING[:3])
    assert result.rank == 3
    assert {d.parameters for d in result.directions} == {("s",), ("t",)}


@pytest.mark.parametrize("without", [(), (6, 7)])
def test_noisy_and_closed_loops_agree(truth, without):
    q = read_poses("hinge_exact.csv")[:40]
    names = tuple(n for n in NAMES if n not in {f"theta_off_{j}" for j in without})
    x = truth.values(NAMES)
    errors = ErrorModel(joint_variance=np.full(q.shape, 1e-10))
    order = np.random.default_rng(1).permutation(len(q))
    fit = expected_fit(loop_of(truth), q[order], errors, x)
    result = identifiability_of_fit(fit, names, taken=order, without=without)
    blind = loop_of(truth, unsensed=without)
    there = identifiability(blind, np.array([x[NAMES.index(p.name)] for p in blind.parameters]), q)
    assert result.rank == there.rank == len(names)
    assert result.scaled_condition_number == pytest.approx(there.scaled_condition_number, rel=1e-6)
    assert result.condition_number == pytest.approx(there.condition_number, rel=1e-6)
    assert result.weakest.parameters == there.weakest.parameters
    assert [n for n, _ in result.trend] == [n for n, _ in there.trend]
    assert [c for _, c in result.trend] == pytest.approx([c for _, c in there.trend], rel=1e-6)

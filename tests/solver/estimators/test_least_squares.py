"""Least squares in blocks against one call that sees all rows."""

import numpy as np
import pytest

from solver.estimators.least_squares import BLOCK_ROWS, solve_damped, triangle_of


def rows(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(count, 14)) * np.logspace(-4, 3, 14)
    return rng.normal(size=count) + J @ (1.0 / np.logspace(-4, 3, 14)), J


@pytest.mark.parametrize("count", [5, 14, 15, 500, 3 * BLOCK_ROWS + 17])
@pytest.mark.parametrize("cuts", [1, 2, 7])
def test_a_triangle_is_sufficient_for_least_squares(count, cuts):
    r, J = rows(count)
    result = triangle_of(zip(np.array_split(r, cuts), np.array_split(J, cuts), strict=True))
    scale = np.linalg.norm(J, axis=0)
    assert np.abs((result.T.T @ result.T - J.T @ J) / np.outer(scale, scale)).max() < 1e-12
    assert result.cost == pytest.approx(0.5 * float(r @ r), rel=1e-12)
    dx = np.random.default_rng(1).normal(size=14) / scale
    left = r + J @ dx
    mine = result.b + result.T @ dx
    assert float(mine @ mine) + result.rest == pytest.approx(float(left @ left), rel=1e-11)
    if count >= 14:
        known = -np.linalg.lstsq(J / scale, r, rcond=None)[0] / scale
        np.testing.assert_allclose(result.step()[0], known, rtol=1e-9)


def test_an_undetermined_direction_gets_no_step():
    r, J = rows(100)
    J[:, 3] = 2.0 * J[:, 5]
    step, _ = triangle_of([(r, J)]).step()
    scale = np.linalg.norm(J, axis=0)
    known = -np.linalg.pinv(J / scale, rcond=1e-12) @ r / scale
    np.testing.assert_allclose(step, known, rtol=1e-8)


def test_non_finite_numbers_give_a_non_finite_step():
    r, J = rows(100)
    J[7, 7] = np.nan
    assert np.isnan(triangle_of([(r, J)]).step()[0]).all()


def test_no_blocks_are_refused():
    with pytest.raises(ValueError, match="one block"):
        triangle_of([])


def test_rosenbrock_converges_from_the_usual_start():
    def problem(x: np.ndarray) -> object:
        r = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
        return triangle_of([(r, np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]]))])

    fit = solve_damped(problem, np.array([-1.2, 1.0]))
    assert fit.converged
    np.testing.assert_allclose(fit.x, [1.0, 1.0], atol=1e-12)
    assert fit.cost < 1e-24


def test_a_minimum_with_residuals_is_reached_directly():
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 4.0, 80)
    y = 2.0 * np.exp(-0.7 * t) + 0.05 * rng.normal(size=80)

    def problem(x: np.ndarray) -> object:
        e = np.exp(-x[1] * t)
        return triangle_of([(x[0] * e - y, np.stack((e, -x[0] * t * e), axis=-1))])

    fit = solve_damped(problem, np.array([1.0, 0.1]))
    assert fit.converged
    assert fit.iterations < 12
    T, b = fit.triangle.T, fit.triangle.b
    # The gradient at the end, in units of what rounding leaves of it.
    assert np.abs(T.T @ b).max() < 1e-6 * np.abs(T).max() * np.sqrt(2.0 * fit.cost)

"""Rows of measured distances, against central differences."""

import numpy as np
import pytest

from solver.chain.parameters import Parameter
from solver.estimators.error_model import MeasuredDistance, distance_rows

POINTS = [(f"ground_x[{k}]", f"ground_y[{k}]", f"ground_z[{k}]") for k in (1, 2)]


def test_rows_are_deviations_in_sigmas_and_their_derivatives():
    parameters = [Parameter(name=n, is_angle=False, nominal=0.0) for p in POINTS for n in p]
    known = MeasuredDistance(first=POINTS[0], second=POINTS[1], value_m=0.049, sigma_m=5e-4)
    x = np.random.default_rng(0).normal(size=6)

    def deviation(at: np.ndarray) -> float:
        return float((np.linalg.norm(at[3:] - at[:3]) - 0.049) / 5e-4)

    w, (row,) = distance_rows([known], parameters, x)
    assert w == pytest.approx([deviation(x)])
    numeric = [(deviation(x + h) - deviation(x - h)) / 2e-6 for h in 1e-6 * np.eye(6)]
    assert row == pytest.approx(numeric, abs=1e-6 * np.abs(row).max())

"""Rows of measured distances, against central differences and by hand."""

import numpy as np
import pytest

from solver.chain.parameters import Parameter
from solver.estimators.error_model import MeasuredDistance, distance_and_rates, distance_rows

POINTS = [(f"ground_x[{k}]", f"ground_y[{k}]", f"ground_z[{k}]") for k in (1, 2)]


def test_rates_are_the_derivatives_of_the_distance():
    rng = np.random.default_rng(0)
    x, step = rng.normal(size=8), 1e-6
    _, rates = distance_and_rates((1, 2, 4), (5, 6, 7), x)
    numeric = [
        (np.linalg.norm((x + h)[[5, 6, 7]] - (x + h)[[1, 2, 4]])
         - np.linalg.norm((x - h)[[5, 6, 7]] - (x - h)[[1, 2, 4]])) / (2 * step)
        for h in step * np.eye(8)
    ]  # fmt: skip
    assert rates == pytest.approx(numeric, abs=1e-9)


def test_rows_are_in_units_of_their_sigma():
    names = [n for point in POINTS for n in point]
    x = np.array([0.0, 0.0, 0.0, 0.03, 0.04, 0.0])
    known = MeasuredDistance(first=POINTS[0], second=POINTS[1], value_m=0.049, sigma_m=5e-4)
    w, rows = distance_rows(
        [known], [Parameter(name=n, is_angle=False, nominal=0.0) for n in names], x
    )
    assert w == pytest.approx([2.0])
    assert rows[0] == pytest.approx(np.array([-0.6, -0.8, 0.0, 0.6, 0.8, 0.0]) / 5e-4)

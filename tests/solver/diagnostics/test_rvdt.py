"""Response of an RVDT: degree of its curve and noise of single readings, against draws."""

import numpy as np
import pytest

from solver.diagnostics.rvdt_response import fit_curve, noise_of_spread, spread_of


def test_noise_does_not_raise_the_degree_of_the_curve():
    degrees = []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        x = rng.uniform(-1.0, 1.0, 60)
        degrees.append(fit_curve(x, 0.3 * x + rng.normal(size=60)).degree)
    assert np.mean(np.array(degrees) == 1) > 0.7


@pytest.mark.parametrize("points", [20, 40, 100])
def test_a_linear_sensor_is_called_curved_at_the_stated_rate(points):
    """The degree is the best of several, and noise has as many chances to look like a bend."""
    rng, runs = np.random.default_rng(7), 3000
    curved = 0
    for _ in range(runs):
        x = rng.uniform(-1.0, 1.0, points)
        curved += fit_curve(x, 0.3 * x + rng.normal(size=points)).line_probability < 0.01
    # More than 1.45 % of 3,000 has a chance of 1 % at a rate of 1 %.
    assert curved <= 0.0145 * runs


@pytest.mark.parametrize("lsb", [0.05, 0.2, 0.4, 1.0, 8.0])
def test_noise_is_estimated_from_rounded_readings(lsb):
    """Against rounded draws: below half a count most of the spread is lost, above it 1/12 is added."""
    rng = np.random.default_rng(4)
    readings = np.round(rng.uniform(size=(1, 20_000)) + lsb * rng.normal(size=(16, 20_000)))
    square = float(readings.var(axis=0, ddof=1).mean())
    assert spread_of(lsb) == pytest.approx(square, rel=0.03)
    assert noise_of_spread(square) == pytest.approx(lsb, rel=0.04)


def test_constant_readings_have_no_noise():
    assert noise_of_spread(0.0) == 0.0

"""Intervals, chi-square band, jackknife and outliers: figures by hand, and rates over many runs."""

import numpy as np
import pytest

from solver.chain.parameters import DhEntry, nominal_vector
from solver.diagnostics.statistics import chi2_test, correlations, intervals, jackknife
from solver.errors import TooFewPosesError
from solver.estimators.error_model import ErrorModel
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import Calibrated, estimate_with_errors
from tests.oracles.loop_oracle import Truth
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import NAMES, loop_of

SIMULATION = Simulation(poses=30, wrist_sd=6e-3)
NOISE = NoiseModel(joint_variance=SIMULATION.sigma() ** 2)


def test_intervals_are_normal_or_students_if_residuals_give_the_scale(truth):
    q = SIMULATION.rereadings(0)
    by_noise = estimate_implicit(loop_of(truth), q, NOISE)
    by_residuals = estimate_paper(loop_of(truth), q[:4])
    assert by_residuals.dof == 6
    for estimate, quantile in ((by_noise, 1.959964), (by_residuals, 2.446912)):
        low, high = intervals(estimate)
        sd = estimate.standard_deviation
        assert high - estimate.x == pytest.approx(quantile * sd, rel=1e-6)
        assert estimate.x - low == pytest.approx(quantile * sd, rel=1e-6)


def test_correlations():
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    expected = [[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]
    assert correlations(covariance) == pytest.approx(np.array(expected))
    for scale in (1e300, 1e-300):
        assert correlations(scale * covariance) == pytest.approx(np.array(expected))


def test_chi2_band():
    # 99 % band of chi2 with 100 degrees of freedom, from tables: 67.328 .. 140.169
    result = chi2_test(100.0, 100)
    assert (result.low, result.high) == pytest.approx((0.67328, 1.40169), rel=1e-5)
    assert result.low < 1.0 < result.high
    assert chi2_test(141.0, 100).high < 1.41
    assert chi2_test(67.0, 100).low > 0.67
    with pytest.raises(ValueError, match="degree of freedom"):
        chi2_test(1.0, 0)


def fitted(truth: Truth, q: np.ndarray, *, loose: bool = False) -> Calibrated:
    """Fit readings, with lengths known to 1 mm where `loose`."""
    model = loop_of(truth)
    tolerance = {"s_3": 1e-3, "a_4": 1e-3} if loose else {}
    model = model.freed([DhEntry.parse(name) for name in tolerance])
    variance = np.tile(NOISE.joint_variance, (len(q), 1))
    errors = ErrorModel(joint_variance=variance, tolerance=tolerance)
    return estimate_with_errors(model, q, errors, x0=nominal_vector(model.parameters))


@pytest.mark.parametrize("loose", [False, True])
def test_jackknife_equals_fits_without_each_pose(truth, loose):
    q = SIMULATION.rereadings(1)
    result = fitted(truth, q, loose=loose)
    rest = [fitted(truth, np.delete(q, k, axis=0), loose=loose).estimate.x for k in range(len(q))]
    apart = np.array(rest) - np.mean(rest, axis=0)
    full = np.sqrt((len(q) - 1.0) / len(q) * (apart**2).sum(axis=0))
    assert len(full) == len(NAMES) + 2 * loose
    assert jackknife(result.linear) == pytest.approx(full, rel=0.02)


def test_jackknife_needs_a_spare_pose(truth):
    result = fitted(truth, SIMULATION.rereadings(0)[:3])
    with pytest.raises(TooFewPosesError):
        jackknife(result.linear)

"""The paper's estimator: planted truth, starts from afar, too few poses, its own figures."""

import numpy as np
import pytest

from solver.errors import TooFewPosesError
from solver.estimators.paper import estimate_paper
from tests.oracles.loop_oracle import Truth
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import NAMES, loop_of

EXACT = Simulation(poses=40, wrist_sd=0.0, encoder_sd=0.0)


def start_off(truth: Truth, rng: np.random.Generator) -> Truth:
    """Nominal values 10 deg and 30 mm beside the truth."""
    steps = [
        np.deg2rad(10.0) if n.startswith(("theta_off", "alpha")) else 0.030 for n in NAMES
    ] * rng.uniform(-1.0, 1.0, len(NAMES))
    return truth.with_values(NAMES, truth.values(NAMES) + steps)


@pytest.mark.sample(3)
@pytest.mark.parametrize("seed", range(12))
def test_starts_10_deg_and_30_mm_off_converge(truth, seed):
    q = EXACT.readings(seed=0)
    result = estimate_paper(loop_of(start_off(truth, np.random.default_rng(seed))), q)
    assert result.converged
    assert np.abs(result.x - truth.values(NAMES)).max() < 1e-9
    assert result.sigmas.position_m.rms < 1e-11


def test_two_poses_are_too_few_and_three_suffice(truth):
    q = EXACT.readings(seed=0)
    with pytest.raises(TooFewPosesError, match="at least 3 poses are needed") as refused:
        estimate_paper(loop_of(truth), q[:2])
    assert (refused.value.poses, refused.value.needed) == (2, 3)
    assert "give 10 equations for 14 parameters" in str(refused.value)
    assert estimate_paper(loop_of(truth), q[:3]).dof == 1


def test_covariance_and_both_forms_of_sigma_follow_from_the_residuals(truth):
    q = Simulation(poses=30).readings(seed=3)
    model = loop_of(truth)
    result = estimate_paper(model, q)
    error = model.reduced(result.x, q)
    J, r = error.jac_x.reshape(-1, 14), error.residual.reshape(-1)
    assert result.dof == 30 * 5 - 14
    expected = np.linalg.inv(J.T @ J) * (r @ r) / result.dof
    assert result.covariance == pytest.approx(expected, rel=1e-6)
    assert np.abs(J.T @ r).max() < 1e-9
    rotations, positions = result.residual[:, :2], result.residual[:, 2:]
    sigmas = result.sigmas
    assert sigmas.orientation_rad.rms == pytest.approx(np.sqrt((rotations**2).sum() / 60))
    assert sigmas.orientation_rad.as_printed == pytest.approx(np.sqrt((rotations**2).sum()) / 60)
    assert sigmas.position_m.rms == pytest.approx(np.sqrt((positions**2).sum() / 90))
    assert sigmas.position_m.as_printed == pytest.approx(np.sqrt((positions**2).sum()) / 90)

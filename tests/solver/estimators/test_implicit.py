"""The implicit estimator: planted truth, ODRPACK, the Cramer-Rao bound, unsensed joints."""

import numpy as np
import pytest

from solver.chain.sensors import Encoder
from solver.errors import TooFewPosesError
from solver.estimators.implicit import NoiseModel, estimate_implicit, fit_implicit
from solver.estimators.paper import estimate_paper
from tests.oracles.implicit_odr import fit as odr_fit
from tests.oracles.loop_oracle import cramer_rao
from tests.oracles.simulated_loops import ENCODER_SD, Simulation
from tests.solver.conftest import NAMES, loop_of, read_poses
from tests.solver.estimators.test_paper import EXACT

WRIST = Simulation(poses=40, wrist_sd=6e-3)
UNSENSED = tuple(n for n in NAMES if n not in ("theta_off_6", "theta_off_7"))


def noise_of(simulation: Simulation) -> NoiseModel:
    return NoiseModel(joint_variance=simulation.sigma() ** 2)


def test_a_curved_wrist_does_not_affect_the_arm_if_unsensed(truth):
    q = read_poses("hinge_rvdt1pct.csv")
    result = estimate_implicit(loop_of(truth, unsensed=(6, 7)), q, noise_of(WRIST))
    error = result.x - truth.values(UNSENSED)
    assert result.converged
    assert np.abs(error[:5]).max() < 0.02e-3
    assert np.abs(error[[5, 6, 8, 9, 10]]).max() < 0.02e-3
    paper = estimate_paper(loop_of(truth), q)
    assert np.abs(paper.x - truth.values(NAMES))[:5].max() > 2e-3


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(10))
def test_estimates_agree_with_odrpack(truth, seed):
    q = WRIST.readings(seed)
    mine = estimate_implicit(loop_of(truth), q, noise_of(WRIST))
    sd = np.sqrt(np.diagonal(mine.covariance))
    x, corrections = odr_fit(truth, q, WRIST.sigma(), NAMES, sd)
    assert mine.x == pytest.approx(x, rel=1e-6)
    # Also relative to the standard deviation, for parameters near zero.
    assert np.abs((mine.x - x) / sd).max() < 1e-4
    assert np.abs(mine.corrections - corrections).max() < 1e-6 * 6e-3


def test_covariance_is_the_bound_of_a_second_implementation(truth):
    rng = np.random.default_rng(5)
    closed = EXACT.closed(rng)
    q = closed[:, 1:]
    give = np.array([1e-3] * 3 + [5e-4] * 3) ** 2
    for unsensed, variance_of_give in (((), None), ((6, 7), None), ((), give)):
        model = loop_of(truth, unsensed=unsensed)
        names = [p.name for p in model.parameters]
        noise = NoiseModel(joint_variance=WRIST.sigma() ** 2, fixture_variance=variance_of_give)
        result = fit_implicit(model, q, noise, truth.values(names))
        bound = cramer_rao(
            truth, closed, names, WRIST.sigma() ** 2, unsensed=unsensed, give=variance_of_give
        )
        assert result.covariance == pytest.approx(bound, rel=1e-5, abs=1e-8 * np.abs(bound).max())


def test_adjusted_readings_close_exactly(truth):
    q = WRIST.readings(1)
    model = loop_of(truth)
    result = fit_implicit(model, q, noise_of(WRIST), truth.values(NAMES))
    closed = model.loop(result.x, q + result.corrections, result.unsensed)
    assert np.abs(closed.residual).max() < 1e-12
    weighted = (result.corrections / WRIST.sigma()) ** 2
    assert result.pose_chi2 == pytest.approx(weighted.sum(-1), rel=1e-6)
    assert result.chi2 == pytest.approx(weighted.sum(), rel=1e-6)


def test_too_few_poses_with_unsensed_joints_are_refused(truth):
    q = EXACT.readings(0)
    with pytest.raises(TooFewPosesError, match="at least 5 poses"):
        estimate_implicit(loop_of(truth, unsensed=(6, 7)), q[:4], noise_of(WRIST))


def test_progress_may_cancel(truth):
    def cancel(iteration: int, cost: float) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        estimate_implicit(loop_of(truth), WRIST.readings(0), noise_of(WRIST), progress=cancel)


def test_an_encoders_specification_is_its_quantisation():
    assert Encoder(counts_per_rev=400_000).sigma_rad == pytest.approx(ENCODER_SD)

"""Noise below its stated size is estimated as such, which makes the tests for steps of a reading more powerful."""

from dataclasses import replace

import numpy as np
import pytest

from solver.diagnostics.diagnosis import Diagnosis, diagnose
from solver.diagnostics.fault_models import Cause
from solver.diagnostics.stated_sizes import learned_scales, with_estimated_motion_noise
from solver.estimators.variance_components import Calibrated
from tests.oracles.as_shipped import ARM, fit_of
from tests.oracles.shop_floor import SCATTER, Sizes, session
from tests.oracles.shop_floor_faults import CASES
from tests.oracles.shop_floor_misread import slipped_joint


def diagnosed(calibrated: Calibrated) -> Diagnosis:
    return diagnose(calibrated.linear, ARM, taken=calibrated.order)


def noise_ratios(calibrated: Calibrated) -> tuple[dict[str, float], dict[str, float]]:
    """Estimated standard deviations of all noise, by the stated ones and by those of `at_known_noise`."""
    fit = calibrated.linear
    estimated = with_estimated_motion_noise(fit)
    names = [c.name for c in fit.design.components]
    by_stated = np.sqrt(estimated.v / fit.design.stated_variances())
    by_known = np.sqrt(estimated.v / fit.at_known_noise.v)
    noise = fit.design.noise_components
    return {names[k]: by_stated[k] for k in noise}, {names[k]: by_known[k] for k in noise}


def test_hinge_scatter_is_the_generators_share_of_its_compliance():
    ratios = [noise_ratios(fit_of(session(seed))) for seed in range(3301, 3307)]
    hinge = np.mean([by_stated["fixture_m"] for by_stated, _ in ratios])
    assert hinge == pytest.approx(SCATTER, rel=0.25)
    for _, by_known in ratios:
        assert (by_known["rvdt_6"], by_known["rvdt_7"]) == (1.0, 1.0)


def test_joint_play_as_stated_is_not_reduced_by_a_stiff_hinge():
    simulated = session(3303)
    readings = simulated.readings.copy()
    readings[:, :5] += 3e-4 * np.random.default_rng(1).normal(size=(len(simulated), 5))
    by_stated, by_known = noise_ratios(fit_of(replace(simulated, readings=readings)))
    assert by_known["joint_play"] == 1.0
    assert by_stated["joint_play"] > 0.9
    assert by_stated["fixture_m"] < 0.5


@pytest.mark.parametrize(("extra_rad", "least", "most"), [(0.0, 0.3, 0.4), (5e-4, 0.7, 1.0)])
def test_the_scatter_bounds_what_the_models_leave_out(extra_rad, least, most):
    """An arm without play and sag, with the readings' noise alone and with more noise than is stated."""
    simulated = session(3303, Sizes.only())
    noise = extra_rad * np.random.default_rng(1).normal(size=simulated.readings.shape)
    fitted = fit_of(replace(simulated, readings=simulated.readings + noise))
    scales = {s.family: s.value for s in learned_scales(fitted.linear, fitted.derivatives)}
    assert least < scales["unmodelled"] < most


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", [3007, 3010, 3012])
def test_a_step_of_50_counts_is_found_despite_noisier_joints(seed):
    case = CASES["joint slips 50 counts"](seed)
    (cause,) = case.causes
    diagnosis = diagnosed(fit_of(case.taken))
    assert [test.code for test in diagnosis.tests if test.fires] == ["STEP"]
    assert diagnosis.best.candidate.cause is Cause.LOST_COUNTS
    assert f"STEP_JOINT_{diagnosis.best.candidate.subject}" == cause


@pytest.mark.campaign
def test_sound_sessions_show_no_step():
    tests = [t for seed in range(3310, 3316) for t in diagnosed(fit_of(session(seed))).tests]
    steps = [t for t in tests if t.code == "STEP"]
    assert len(steps) == 6
    assert all(step.statistic < 0.7 * step.threshold for step in steps)
    slipped = slipped_joint(3310, counts=50, only=(1, 2, 3, 4, 5))
    assert not any(test.fires for test in diagnosed(fit_of(session(3310))).tests)
    assert any(test.fires for test in diagnosed(fit_of(slipped.taken)).tests)

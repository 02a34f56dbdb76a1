"""Noise that is quieter than stated is found so, and a shift of a reading is then seen that was not before."""

from dataclasses import replace

import numpy as np
import pytest

from solver.diagnostics.diagnosis import Diagnosis, diagnose
from solver.diagnostics.fault_candidate import Cause
from solver.diagnostics.stated_sizes import with_estimated_motion_noise
from solver.estimators.variance_components import Calibrated
from tests.oracles.as_shipped import ARM, fit_of
from tests.oracles.shop_floor import SCATTER, session
from tests.oracles.shop_floor_faults import CASES
from tests.oracles.shop_floor_misread import slipped_joint


def judged(found: Calibrated) -> Diagnosis:
    return diagnose(found.linear, ARM, taken=found.order)


def shares(found: Calibrated) -> tuple[dict[str, float], dict[str, float]]:
    """Standard deviations of all noise in those that are stated, and in those that were believed before."""
    fit = found.linear
    quiet = with_estimated_motion_noise(fit)
    names = [c.name for c in fit.design.components]
    of_stated = np.sqrt(quiet.v / fit.design.stated_variances())
    of_believed = np.sqrt(quiet.v / fit.at_known_noise.v)
    noise = fit.design.noise_components
    return {names[k]: of_stated[k] for k in noise}, {names[k]: of_believed[k] for k in noise}


def test_hinge_scatter_is_the_generators_share_of_its_compliance():
    found = [shares(fit_of(session(seed))) for seed in range(3301, 3307)]
    of_hinge = np.mean([of_stated["fixture_m"] for of_stated, _ in found])
    assert of_hinge == pytest.approx(SCATTER, rel=0.25)
    for _, of_believed in found:
        assert (of_believed["rvdt_6"], of_believed["rvdt_7"]) == (1.0, 1.0)


def test_joint_play_as_stated_is_not_reduced_by_a_stiff_hinge():
    taken = session(3303)
    readings = taken.readings.copy()
    readings[:, :5] += 3e-4 * np.random.default_rng(1).normal(size=(len(taken), 5))
    of_stated, of_believed = shares(fit_of(replace(taken, readings=readings)))
    assert of_believed["joint_play"] == 1.0
    assert of_stated["joint_play"] > 0.9
    assert of_stated["fixture_m"] < 0.5


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", [3007, 3010, 3012])
def test_a_step_of_50_counts_is_found_despite_noisier_joints(seed):
    case = CASES["joint slips 50 counts"](seed)
    (cause,) = case.causes
    trial = judged(fit_of(case.taken))
    fired = [test.code for test in trial.tests if test.fires]
    assert fired == ["STEP"]
    assert trial.best.candidate.cause is Cause.LOST_COUNTS
    assert f"STEP_JOINT_{trial.best.candidate.subject}" == cause


@pytest.mark.campaign
def test_sound_sessions_show_no_step():
    tests = [t for seed in range(3310, 3316) for t in judged(fit_of(session(seed))).tests]
    steps = [t for t in tests if t.code == "STEP"]
    assert len(steps) == 6
    assert all(step.statistic < 0.7 * step.threshold for step in steps)
    slipped = slipped_joint(3310, counts=50, only=(1, 2, 3, 4, 5))
    assert not any(test.fires for test in judged(fit_of(session(3310))).tests)
    assert any(test.fires for test in judged(fit_of(slipped.taken)).tests)

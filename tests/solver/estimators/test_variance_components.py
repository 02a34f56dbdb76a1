"""One error model: variances found where planted, statements kept as floors, intervals that cover."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from solver.errors import TooFewPosesError
from solver.estimators.error_model import ErrorModel, stated_errors
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.variance_components import (
    Calibrated,
    VarianceComponents,
    estimate_with_errors,
)
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.simulated_loops import RVDT_SD, RvdtCurve, Simulation
from tests.solver.conftest import NAMES, loop_of, paper_arm

STATED = NoiseModel(joint_variance=Simulation().sigma() ** 2)


def sensors(poses: int, *, samples: int = 1, **more: object) -> ErrorModel:
    """What the paper's arm states of its sensors; a fixture that is stated to be rigid."""
    errors = stated_errors(paper_arm(paper_truth()), samples=np.full(poses, samples))
    return replace(errors, **{"give_rad": 0.0, "give_m": 0.0, **more})


def exact(poses: int, **more: object) -> ErrorModel:
    """Stated noise and nothing else, none of it estimated."""
    variance = np.broadcast_to(STATED.joint_variance, (poses, 7)).copy()
    return ErrorModel(joint_variance=variance, **more)


def sd(results: VarianceComponents, name: str) -> float:
    return next((c.sd for c in results.components if c.name == name), 0.0)


def calibrated(simulation: Simulation, seed: int, errors: ErrorModel | None = None) -> Calibrated:
    q = simulation.readings(seed)
    errors = sensors(len(q)) if errors is None else errors
    truth = simulation.truth
    return estimate_with_errors(loop_of(truth), q, errors, x0=truth.values(NAMES))


def test_excess_wrist_noise_is_found(truth):
    simulation = Simulation(poses=60, wrist_sd=6e-3)
    inside, deflects, hits = 0, 0, np.zeros(14)
    runs = 10
    for seed in range(runs):
        whole = estimate_with_errors(loop_of(truth), simulation.rereadings(seed), sensors(60))
        estimate, vc = whole.estimate, whole.components
        assert estimate.converged
        noise = [c for c in vc.components if c.name.startswith("rvdt")]
        assert [c.name for c in noise] == ["rvdt_6", "rvdt_7"]
        inside += sum(c.low < 6e-3 < c.high for c in noise)
        hits += np.abs(estimate.x - truth.values(NAMES)) < 1.96 * estimate.standard_deviation
        # The same readings are no surprise to the fitted noise, and a great one to the stated.
        assert 0.8 < whole.linear.chi2 / whole.linear.dof < 1.1
        assert whole.linear.stated.chi2 / whole.linear.stated.dof > 2.0
        deflects += sd(vc, "fixture_m") > 1e-3
    # 95 % of 20: fewer than 16 has a chance of 3e-3.
    assert inside >= 16
    assert deflects == 0
    assert hits.sum() >= binom.ppf(1e-4, 14 * runs // 4, 0.95) * 4


@pytest.mark.campaign
def test_components_are_separated():
    simulation = Simulation(poses=60, wrist_sd=4e-3, flexure_m=1e-3, flexure_rad=2e-3)
    runs, hits, inside = 6, np.zeros(14), dict.fromkeys(("rvdt_6", "fixture_m", "fixture_rad"), 0)
    true = {"rvdt_6": 4e-3, "fixture_m": 1e-3, "fixture_rad": 2e-3}
    for seed in range(runs):
        whole = calibrated(simulation, seed)
        estimate, vc = whole.estimate, whole.components
        assert estimate.converged
        assert vc.compliance is not None
        assert vc.compliance.deflects
        assert {c.name: c.unit for c in vc.components}["fixture_m"] == "m"
        assert sd(vc, "fixture_m") == pytest.approx(1e-3, rel=0.35)
        for component in vc.components:
            if component.name in inside:
                inside[component.name] += component.low < true[component.name] < component.high
        goal = simulation.truth.values(NAMES)
        hits += np.abs(estimate.x - goal) < 1.96 * estimate.standard_deviation
    # 95 % each: three misses of six have a chance of 2e-3.
    assert min(inside.values()) >= 4
    assert hits.mean() / runs > 0.85


@pytest.mark.campaign
def test_a_fixture_as_compliant_as_stated_is_no_finding(truth):
    simulation = Simulation(poses=40, flexure_m=2e-4, flexure_rad=2e-4)
    errors = sensors(40, give_rad=2e-4, give_m=2e-4)
    surprises = 0
    for seed in range(8):
        vc = calibrated(simulation, seed, errors).components
        assert vc.compliance is not None
        surprises += vc.compliance.deflects
        assert sd(vc, "fixture_m") >= 1e-4 * (1.0 - 1e-9)
    # At 1 %: two of eight have a chance of 3e-3.
    assert surprises <= 1


def test_without_sources_it_equals_the_implicit_estimator(truth):
    q = Simulation(poses=40).rereadings(0)
    plain = estimate_implicit(loop_of(truth), q, STATED)
    whole = estimate_with_errors(loop_of(truth), q, exact(40))
    assert whole.components.components == ()
    assert whole.components.compliance is None
    assert whole.estimate.x == pytest.approx(plain.x, abs=1e-9)
    assert whole.estimate.covariance == pytest.approx(plain.covariance, rel=1e-5)
    assert whole.estimate.chi2 == pytest.approx(plain.chi2, rel=1e-6)
    assert whole.components.repeatability == pytest.approx(plain.covariance, rel=1e-5)


def test_a_tolerance_acts_as_a_prior(truth):
    q = Simulation(poses=40).rereadings(0)
    model = loop_of(truth, names=(*NAMES, "s_3"))
    goal = truth.values((*NAMES, "s_3"))

    def with_tolerance(sd: float):
        # Held at its statement: what is asked here is the prior, not its variance.
        return estimate_with_errors(model, q, exact(40, tolerance={"s_3": sd}), x0=goal).estimate

    free = estimate_implicit(model, q, STATED)
    fixed = estimate_implicit(loop_of(truth), q, STATED)
    loose, tight = with_tolerance(1.0), with_tolerance(1e-9)
    assert loose.x == pytest.approx(free.x, abs=1e-8)
    assert loose.covariance == pytest.approx(free.covariance, rel=1e-3)
    assert tight.dof == fixed.dof
    assert free.dof == fixed.dof - 1
    own = float(free.standard_deviation[14])
    middle = with_tolerance(own)
    # In between, knowledge adds up.
    assert middle.standard_deviation[14] < own * 1.001
    assert middle.standard_deviation[14] > 0.7 * own


def test_the_predicted_curve_is_the_planted_one():
    bow = RvdtCurve((0.01, -0.006), float(paper_truth().home[5]))
    simulation = Simulation(poses=60, bows={6: bow})
    q = simulation.rereadings(0)
    calibrated = estimate_with_errors(loop_of(paper_truth()), q, sensors(60))
    vc, fit = calibrated.components, calibrated.linear
    corrected = fit.design.q + calibrated.estimate.corrections[calibrated.order]
    curve = -fit.design.effects_at(fit.b, corrected)[0][:, 5]
    planted = bow(fit.design.q[:, 5])
    assert np.ptp(curve - planted) < 0.1 * np.ptp(planted)
    assert sd(vc, "rvdt_6") == pytest.approx(RVDT_SD, rel=0.35)
    assert sd(vc, "curve_6") > 3e-3


def test_errors_must_refer_to_the_loop(truth):
    q = Simulation(poses=20).rereadings(0)
    for errors, message in (
        (sensors(20, tolerance={"s_3": 1e-3}), "not a free parameter"),
        (sensors(20, tolerance={"a_0": 0.0}), "must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            estimate_with_errors(loop_of(truth), q, errors, x0=truth.values(NAMES))
    unsensed = loop_of(truth, unsensed=(6, 7))
    with pytest.raises(ValueError, match="joint 6"):
        estimate_with_errors(unsensed, q, sensors(20), x0=np.zeros(12))
    with pytest.raises(TooFewPosesError):
        estimate_with_errors(loop_of(truth), q[:2], sensors(2))

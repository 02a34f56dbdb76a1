"""Variance components: found where planted, zero where not, and honest intervals of the parameters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from solver.chain.sensor_curve import SensorCurve, curves_of
from solver.errors import TooFewPosesError
from solver.estimators.component_model import ComponentPlan, plan_of
from solver.estimators.estimate import Estimate
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.variance_components import (
    VarianceComponents,
    estimate_implicit_with_components,
)
from solver.judging.statistics import chi2_test
from tests.oracles.loop_oracle import Truth, paper_truth
from tests.oracles.simulated_loops import (
    FULL_SCALE_RAD,
    LENGTHS,
    RVDT_SD,
    Bow,
    Simulation,
    as_reported,
)
from tests.solver.conftest import NAMES, loop_of, paper_arm

STATED = NoiseModel(joint_variance=Simulation().sigma() ** 2)
NOISY = ComponentPlan(noisy_joints=(6, 7))
CURVES = tuple(
    SensorCurve(
        joint=j,
        middle_rad=float(paper_truth().home[j - 1]),
        half_scale_rad=0.5 * FULL_SCALE_RAD,
    )
    for j in (6, 7)
)


def found(
    simulation: Simulation, seed: int, plan: ComponentPlan = NOISY
) -> tuple[Estimate, VarianceComponents]:
    truth = simulation.truth
    return estimate_implicit_with_components(
        loop_of(truth), simulation.readings(seed), STATED, plan, x0=truth.values(NAMES)
    )


def test_wrist_noise_beyond_its_specification_is_found(truth: Truth) -> None:
    simulation = Simulation(poses=60, wrist_sd=6e-3)
    inside, gives, bands, hits = 0, 0, 0, np.zeros(14)
    runs = 10
    for seed in range(runs):
        q = simulation.rereadings(seed)
        estimate, vc = estimate_implicit_with_components(loop_of(truth), q, STATED, NOISY)
        assert vc.converged
        assert [c.name for c in vc.components] == ["rvdt_6", "rvdt_7"]
        inside += sum(c.low < 6e-3 < c.high for c in vc.components)
        gives += vc.flexure is not None and vc.flexure.gives
        assert estimate.chi2 is not None
        bands += chi2_test(estimate.chi2, estimate.dof).accepted
        goal = truth.values(NAMES)
        hits += np.abs(estimate.x - goal) < 1.96 * estimate.standard_deviation
    # 95 % of 20: fewer than 16 has a chance of 3e-3; a false flexure at 1 %: two of 10, 4e-3.
    assert inside >= 16
    assert gives <= 1
    assert bands == runs
    assert hits.sum() >= binom.ppf(1e-4, 14 * runs // 4, 0.95) * 4


def test_stated_noise_would_have_been_overconfident(truth: Truth) -> None:
    q = Simulation(poses=60, wrist_sd=6e-3).rereadings(0)
    plain = estimate_implicit(loop_of(truth), q, STATED)
    assert plain.chi2 is not None
    assert not chi2_test(plain.chi2, plain.dof).accepted
    estimate, _ = estimate_implicit_with_components(loop_of(truth), q, STATED, NOISY)
    assert estimate.standard_deviation[5] > 3.0 * plain.standard_deviation[5]


def test_components_separate() -> None:
    simulation = Simulation(poses=60, wrist_sd=4e-3, flexure_m=1e-3, flexure_rad=2e-3)
    runs, hits, inside = 6, np.zeros(14), dict.fromkeys(("rvdt_6", "fixture_m", "fixture_rad"), 0)
    true = {"rvdt_6": 4e-3, "fixture_m": 1e-3, "fixture_rad": 2e-3}
    for seed in range(runs):
        estimate, vc = found(simulation, seed)
        assert vc.converged
        assert vc.flexure is not None
        assert vc.flexure.gives
        assert {c.name: c.unit for c in vc.components}["fixture_m"] == "m"
        assert vc.sd("fixture_m") == pytest.approx(1e-3, rel=0.3)
        for component in vc.components:
            if component.name in inside:
                inside[component.name] += component.low < true[component.name] < component.high
        assert estimate.chi2_per_dof == pytest.approx(1.0, abs=1e-3)
        goal = simulation.truth.values(NAMES)
        hits += np.abs(estimate.x - goal) < 1.96 * estimate.standard_deviation
    # 95 % each: three misses of six have a chance of 2e-3.
    assert min(inside.values()) >= 4
    assert hits.mean() / runs > 0.85


def test_component_of_a_noiseless_joint_ends_at_its_floor(truth: Truth) -> None:
    simulation = Simulation(poses=40, wrist_sd=1e-7)
    q = simulation.rereadings(0)
    estimate, vc = estimate_implicit_with_components(loop_of(truth), q, STATED, NOISY)
    assert estimate.converged
    assert all(c.sd < 2e-5 for c in vc.components)
    assert all(c.low <= c.sd <= c.high for c in vc.components)


def test_without_any_component_it_is_the_plain_estimator(truth: Truth) -> None:
    q = Simulation(poses=40).rereadings(0)
    plain = estimate_implicit(loop_of(truth), q, STATED)
    same, vc = estimate_implicit_with_components(
        loop_of(truth), q, STATED, ComponentPlan(flexure=False)
    )
    assert vc.components == ()
    assert vc.flexure is None
    assert same.x == pytest.approx(plain.x, abs=1e-11)
    assert same.covariance == pytest.approx(plain.covariance, rel=1e-6)
    assert same.chi2 == pytest.approx(plain.chi2, rel=1e-6)


def test_a_tolerance_is_a_prior(truth: Truth) -> None:
    q = Simulation(poses=40).rereadings(0)
    model = loop_of(truth, names=(*NAMES, "s_3"))
    goal = truth.values((*NAMES, "s_3"))

    def with_tolerance(sd: float) -> Estimate:
        plan = ComponentPlan(flexure=False, tolerance={"s_3": sd})
        return estimate_implicit_with_components(model, q, STATED, plan, x0=goal)[0]

    free = estimate_implicit(model, q, STATED)
    fixed = estimate_implicit(loop_of(truth), q, STATED)
    loose, tight = with_tolerance(1.0), with_tolerance(1e-9)
    assert loose.x == pytest.approx(free.x, abs=1e-9)
    assert loose.covariance == pytest.approx(free.covariance, rel=1e-4)
    assert tight.x[:14] == pytest.approx(fixed.x, abs=1e-9)
    assert tight.covariance[:14, :14] == pytest.approx(fixed.covariance, rel=1e-3)
    assert tight.x[14] == pytest.approx(0.355, abs=1e-10)
    # In between, knowledge adds up.
    middle = with_tolerance(float(free.standard_deviation[14]))
    expected = free.standard_deviation[14] / np.sqrt(2.0)
    assert middle.standard_deviation[14] == pytest.approx(expected, rel=1e-4)
    assert tight.dof == middle.dof == fixed.dof
    assert free.dof == fixed.dof - 1


@pytest.mark.parametrize("unsensed", [(), (6, 7)])
def test_as_reported_intervals_are_honest(unsensed: tuple[int, ...]) -> None:
    runs, hits, total = 5, 0, 0
    names = (*NAMES, *LENGTHS)
    model = loop_of(paper_truth(), names=names, unsensed=unsensed)
    plan = ComponentPlan(
        noisy_joints=() if unsensed else (6, 7),
        curves=() if unsensed else CURVES,
        tolerance=dict.fromkeys(LENGTHS, 1.5e-3),
    )
    own = [p.name for p in model.parameters if p.name in NAMES]
    for seed in range(runs):
        truth, q = as_reported(seed)
        estimate, vc = estimate_implicit_with_components(model, q, STATED, plan)
        assert vc.flexure is not None
        assert vc.flexure.gives
        assert estimate.chi2 is not None
        assert chi2_test(estimate.chi2, estimate.dof).accepted
        error = np.array([estimate.value(n) - truth.value(n) for n in own])
        sd = estimate.standard_deviation[: len(own)]
        hits += int((np.abs(error) < 1.96 * sd).sum())
        total += len(own)
    # Parameters of one arm are correlated: count each arm as three independent parameters.
    assert hits / total >= binom.ppf(1e-3, 3 * runs, 0.95) / (3 * runs)


def test_white_noise_alone_is_overconfident_there() -> None:
    # What the plan of the test above is for: a curve and a wrong length do not average out.
    hits = 0
    for seed in range(4):
        truth, q = as_reported(seed)
        estimate, _ = estimate_implicit_with_components(loop_of(paper_truth()), q, STATED, NOISY)
        error = estimate.x - truth.values(NAMES)
        hits += int((np.abs(error) < 1.96 * estimate.standard_deviation).sum())
    assert hits / 56 < 0.6


def test_predicted_curve_is_the_planted_one() -> None:
    bow = Bow((0.01, -0.006), float(paper_truth().home[5]))
    q = Simulation(poses=60, bows={6: bow}).rereadings(0)
    plan = ComponentPlan(noisy_joints=(6, 7), curves=CURVES)
    _, vc = estimate_implicit_with_components(loop_of(paper_truth()), q, STATED, plan)
    assert np.ptp(vc.curves_rad[6] - bow(q[:, 5])) < 0.1 * np.ptp(bow(q[:, 5]))
    assert vc.sd("rvdt_6") == pytest.approx(RVDT_SD, rel=0.35)
    assert vc.sd("curve_6") > 3e-3


def test_plan_must_make_sense(truth: Truth) -> None:
    q = Simulation(poses=20).rereadings(0)
    for plan, message in (
        (ComponentPlan(noisy_joints=(8,)), "joint 8"),
        (ComponentPlan(tolerance={"s_3": 1e-3}), "not a free parameter"),
        (ComponentPlan(tolerance={"a_0": 0.0}), "must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            estimate_implicit_with_components(loop_of(truth), q, STATED, plan)
    unsensed = loop_of(truth, unsensed=(6, 7))
    with pytest.raises(ValueError, match="joint 6"):
        estimate_implicit_with_components(unsensed, q, STATED, NOISY)
    with pytest.raises(TooFewPosesError):
        estimate_implicit_with_components(loop_of(truth), q[:2], STATED, NOISY)


def test_curves_come_from_the_arm(truth: Truth) -> None:
    arm = paper_arm(truth)
    assert [c.joint for c in curves_of(arm)] == [6, 7]
    assert [c.joint for c in curves_of(arm, unsensed_joints=(6,))] == [7]
    assert curves_of(arm)[0].middle_rad == pytest.approx(truth.home[5])
    assert curves_of(arm)[0].half_scale_rad == pytest.approx(0.5 * FULL_SCALE_RAD)
    assert plan_of(arm).noisy_joints == (6, 7)
    assert plan_of(arm, unsensed_joints=(6, 7)) == ComponentPlan()

import itertools
from dataclasses import replace

import numpy as np
import pytest

from hardware.virtual import SCENARIOS
from hardware.virtual.scenarios import STIFF, Scenario, scenario
from hardware.virtual.true_loop import PAPER_HOME_RAD, hinge_truth, paper_loop
from solver.chain.parameters import wrap_angle
from solver.chain.sensors import Encoder
from tests.hardware.virtual.conftest import BLOCKED, SARCOS, commands, sensed_rad


def test_paper_loop_closes_at_the_published_home():
    hinge, *joints = paper_loop().closed_near(PAPER_HOME_RAD)
    np.testing.assert_allclose(
        np.rad2deg(joints - paper_loop().offsets_rad), np.rad2deg(PAPER_HOME_RAD), atol=1e-4
    )
    assert np.rad2deg(hinge) == pytest.approx(-118.936, abs=1e-3)


def test_loop_that_cannot_close_is_refused():
    table = paper_loop().table
    far = hinge_truth(replace(table, a_m=table.a_m + 2.0 * (np.arange(8) == 0)))
    with pytest.raises(ValueError, match="does not close"):
        far.closed_near(PAPER_HOME_RAD)


def test_exact_scenario_has_fine_encoders_without_noise():
    joints = scenario("exact").arm(SARCOS).joints
    assert [j.sensor for j in joints] == [Encoder(counts_per_rev=400_000)] * 7
    assert [j.name for j in joints] == [j.name for j in SARCOS.joints]
    assert scenario("datasheet").arm(SARCOS) is SARCOS
    assert {s.noise_counts for s in scenario("exact").build(SARCOS).sensors} == {0.0}


def test_as_reported_scenario_has_errors_of_the_stated_size():
    reported = scenario("as_reported", 5)
    deviations = reported.true_loop().table.stacked() - paper_loop().table.stacked()
    changed = np.abs(deviations[deviations != 0.0])
    assert changed.size == 11  # a_1 .. a_6, s_2 .. s_6
    assert changed.min() >= 1e-3
    assert changed.max() <= 2e-3
    curves = reported.curves(SARCOS)
    assert curves[:5] == (None,) * 5
    for curve in curves[5:]:
        assert curve.peak_rad() == pytest.approx(np.deg2rad(0.019 * 120.0))


def test_error_sources_are_independent():
    reported = scenario("as_reported", 2)
    linear = replace(reported, linearity_of_full_scale=0.0)
    assert linear.curves(SARCOS) == (None,) * 7
    np.testing.assert_array_equal(linear.true_loop().table.s_m, reported.true_loop().table.s_m)
    true_lengths = replace(reported, lengths=None)
    np.testing.assert_array_equal(true_lengths.true_loop().table.a_m, paper_loop().table.a_m)
    curves = true_lengths.curves(SARCOS)[6], reported.curves(SARCOS)[6]
    np.testing.assert_array_equal(*(curve.coefficients_rad for curve in curves))
    longer = replace(reported, lengths=(0.004, 0.005))
    difference = longer.true_loop().table.s_m[2:7] - paper_loop().table.s_m[2:7]
    assert np.all((np.abs(difference) >= 0.004) & (np.abs(difference) <= 0.005))


def test_only_the_compliant_fixture_deflects():
    def deflections(tested: Scenario) -> np.ndarray:
        plant = tested.build(SARCOS)
        start, errors = SARCOS.home_rad, []
        for part in [*np.linspace(0.0, 1.0, 60), *[1.0] * 30]:
            plant.step(commands({1: start[0] + 0.2 * part, 5: start[4] - 0.4 * part}))
            errors.append(plant.closure_error)
        return np.array(errors)

    reported = scenario("as_reported")
    assert 3e-4 < np.linalg.norm(deflections(reported)[-1, 3:]) < 5e-3
    assert np.abs(deflections(replace(reported, loads=STIFF))).max() < 1e-6
    assert np.abs(deflections(scenario("datasheet"))).max() < 1e-6


def test_as_reported_scenario_varies_only_its_noise_with_the_seed():
    one, same, other = (scenario("as_reported", seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.true_loop().table.s_m, other.true_loop().table.s_m)
    plants = [tested.build(SARCOS) for tested in (one, same, other)]
    counts = [[plant.step(BLOCKED).position_counts[5:] for _ in range(10)] for plant in plants]
    assert counts[0] == counts[1] != counts[2]


def test_holding_at_the_measured_position_needs_little_torque():
    """The drive closes its loop on its sensor, so a linearity deviation of 2 deg is no control error."""
    plant = replace(scenario("datasheet", 1), noise=False).build(SARCOS)
    resolution_rad = [sensor.resolution_rad for sensor in plant.sensors]
    measured = np.array(plant.step(BLOCKED).position_counts) * resolution_rad
    assert np.rad2deg(np.abs(measured - sensed_rad(plant))[5:].max()) > 0.3
    for _ in range(50):
        reading = plant.step(commands(dict(enumerate(measured.tolist(), 1))))
    assert max(map(abs, reading.torque_nm)) < 15.0


@pytest.mark.sample(4)
@pytest.mark.parametrize("seed", range(20))
def test_wild_arm_starts_closed_and_moves_within_its_ranges(seed):
    plant = scenario("wild", seed).build(SARCOS)
    assert np.abs(plant.closure_error).max() < 1e-9
    start = sensed_rad(plant)
    np.testing.assert_allclose(start, SARCOS.home_rad, atol=1e-3)
    hardest, moved = 0.0, np.zeros(7)
    for corner in ((48.0, -70.0), (-30.0, 0.0)):
        begin = sensed_rad(plant)[[0, 4]]
        end = start[[0, 4]] + np.deg2rad(corner)
        for part in np.linspace(0.0, 1.0, 200):
            target = begin + part * (end - begin)
            reading = plant.step(commands({1: target[0], 5: target[1]}))
            hardest = max(hardest, *map(abs, reading.torque_nm))
            sensed = sensed_rad(plant)
            assert np.all(sensed > SARCOS.lower_rad)
            assert np.all(sensed < SARCOS.upper_rad)
            moved = np.maximum(moved, np.abs(sensed - start))
    assert hardest < SARCOS.joints[0].max_torque_nm
    assert np.all(np.rad2deg(moved) > 2.0)


@pytest.mark.campaign
def test_random_arms_differ_from_the_paper_and_each_other():
    offsets_rad = [paper_loop().offsets_rad]
    offsets_rad += [scenario("wild", seed).truth.offsets_rad for seed in range(6)]
    for one, other in itertools.combinations(offsets_rad, 2):
        assert np.abs(wrap_angle(one - other)).max() > np.deg2rad(3.0)


def test_invalid_scenario_or_seed_is_refused():
    with pytest.raises(ValueError, match=", ".join(SCENARIOS)):
        scenario("nominal")
    with pytest.raises(ValueError, match="seed"):
        scenario("exact", -1)

"""Scenarios: what each promises, which error sources are on, and that a seed says it all."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.arm import JointMode
from hardware.virtual import SCENARIOS
from hardware.virtual.axis import JointCommand
from hardware.virtual.plant import Plant
from hardware.virtual.scenarios import STIFF, Scenario, scenario
from hardware.virtual.true_loop import PAPER_HOME_RAD, LoopTruth, paper_loop
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.parameters import wrap_angle
from solver.chain.sensors import Encoder


def reading_rad(plant: Plant, commands: list[JointCommand]) -> FloatArray:
    counts = np.array(plant.step(commands).position_counts)
    return counts * [sensor.resolution_rad for sensor in plant.sensors.sensors]


def test_the_paper_loop_closes_at_the_published_home():
    joints, hinge = paper_loop().closed_near(PAPER_HOME_RAD)
    np.testing.assert_allclose(
        np.rad2deg(joints - paper_loop().offsets_rad), np.rad2deg(PAPER_HOME_RAD), atol=1e-4
    )
    assert np.rad2deg(hinge) == pytest.approx(-118.936, abs=1e-3)


def test_a_loop_that_cannot_close_is_refused():
    table = paper_loop().table
    far = LoopTruth(table=replace(table, a_m=table.a_m + 2.0 * (np.arange(8) == 0)))
    with pytest.raises(ValueError, match="does not close"):
        far.closed_near(PAPER_HOME_RAD)


def test_exact_carries_fine_encoders_everywhere_and_says_so(sarcos):
    carried = scenario("exact").arm(sarcos)
    assert [j.sensor for j in carried.joints] == [Encoder(counts_per_rev=400_000)] * 7
    assert [j.name for j in carried.joints] == [j.name for j in sarcos.joints]
    assert scenario("datasheet").arm(sarcos) is sarcos
    plant = scenario("exact").build(sarcos)
    assert {s.noise_counts for s in plant.sensors.sensors} == {0.0}


def test_as_reported_has_plausible_errors(sarcos):
    reported = scenario("as_reported", 5)
    off = reported.true_loop().table.stacked() - paper_loop().table.stacked()
    changed = np.abs(off[off != 0.0])
    assert changed.size == 11  # a_1 .. a_6, s_2 .. s_6
    assert changed.min() >= 1e-3
    assert changed.max() <= 2e-3
    curves = reported.curves(sarcos)
    assert curves[:5] == (None,) * 5
    for curve in curves[5:]:
        assert curve is not None
        assert curve.peak_rad() == pytest.approx(np.deg2rad(0.019 * 120.0))


def test_each_error_source_switches_alone(sarcos):
    reported = scenario("as_reported", 2)
    straight = replace(reported, linearity_of_full_scale=0.0)
    assert straight.curves(sarcos) == (None,) * 7
    np.testing.assert_array_equal(straight.true_loop().table.s_m, reported.true_loop().table.s_m)
    true_lengths = replace(reported, lengths=None)
    np.testing.assert_array_equal(true_lengths.true_loop().table.a_m, paper_loop().table.a_m)
    kept, was = true_lengths.curves(sarcos)[6], reported.curves(sarcos)[6]
    assert kept is not None
    assert was is not None
    np.testing.assert_array_equal(kept.coefficients_rad, was.coefficients_rad)
    longer = replace(reported, lengths=(0.004, 0.005))
    difference = longer.true_loop().table.s_m[2:7] - paper_loop().table.s_m[2:7]
    assert np.all((np.abs(difference) >= 0.004) & (np.abs(difference) <= 0.005))


def test_only_the_yielding_fixture_gives(sarcos, drive):
    def bend_m(what: Scenario) -> float:
        plant = what.build(sarcos)
        start = sarcos.home_rad
        for part in np.linspace(0.0, 1.0, 60):
            plant.step(drive({1: start[0] + 0.2 * part, 5: start[4] - 0.4 * part}))
        for _ in range(30):
            plant.step(drive({1: start[0] + 0.2, 5: start[4] - 0.4}))
        return float(np.linalg.norm(plant.closure_error[3:]))

    reported = scenario("as_reported")
    assert 3e-4 < bend_m(reported) < 5e-3
    assert bend_m(replace(reported, loads=STIFF)) < 1e-6
    assert bend_m(scenario("datasheet")) < 1e-6


def test_a_seed_is_one_arm_and_one_history(sarcos, drive):
    def history(seed: int) -> list[tuple[int, ...]]:
        plant = scenario("datasheet", seed).build(sarcos)
        start = sarcos.home_rad
        return [
            plant.step(drive({1: start[0] + 0.002 * k, 5: start[4]})).position_counts
            for k in range(60)
        ]

    assert history(4) == history(4)
    assert history(4) != history(5)


def test_as_reported_is_one_specimen_and_the_seed_its_noise(sarcos):
    one, other = scenario("as_reported", 1), scenario("as_reported", 2)
    np.testing.assert_array_equal(one.true_loop().table.s_m, other.true_loop().table.s_m)
    hold = [JointCommand(mode=None, target_rad=0.0)] * 7
    plants = [what.build(sarcos) for what in (one, other)]
    first, second = ([plant.step(hold).position_counts[5:] for _ in range(10)] for plant in plants)
    assert first != second


def test_holding_at_the_measured_position_pulls_on_nothing(sarcos):
    """The drive closes its loop on its sensor: an RVDT's curve of 2 deg is not 2 deg of error."""
    plant = replace(scenario("datasheet", 1), noise=False).build(sarcos)
    hold = [JointCommand(mode=None, target_rad=0.0)] * 7
    measured = reading_rad(plant, hold)
    true = (plant.true_angles_rad - np.concatenate(([0.0], plant.truth.offsets_rad)))[1:]
    assert np.rad2deg(np.abs(measured - true)[5:].max()) > 0.3
    for _ in range(50):
        reading = plant.step(
            [JointCommand(mode=JointMode.POSITION, target_rad=float(m)) for m in measured]
        )
    assert max(map(abs, reading.torque_nm)) < 15.0


@pytest.mark.sample(4)
@pytest.mark.parametrize("seed", range(20))
def test_every_wild_arm_starts_closed_inside_its_ranges_and_moves(sarcos, drive, seed):
    plant = scenario("wild", seed).build(sarcos)
    assert np.abs(plant.closure_error).max() < 1e-9
    # RVDT noise would hide nothing here, but true angles say more.
    start = plant.true_angles_rad[1:] - plant.truth.offsets_rad
    np.testing.assert_allclose(start, sarcos.home_rad, atol=1e-3)
    hardest, moved = 0.0, np.zeros(7)
    for corner in ((48.0, -70.0), (-30.0, 0.0)):
        here = plant.true_angles_rad[1:] - plant.truth.offsets_rad
        goal = start[[0, 4]] + np.deg2rad(corner)
        for part in np.linspace(0.0, 1.0, 200):
            now = here[[0, 4]] + part * (goal - here[[0, 4]])
            reading = plant.step(drive({1: now[0], 5: now[1]}))
            hardest = max(hardest, *map(abs, reading.torque_nm))
            sensed = plant.true_angles_rad[1:] - plant.truth.offsets_rad
            assert np.all(sensed > sarcos.lower_rad)
            assert np.all(sensed < sarcos.upper_rad)
            moved = np.maximum(moved, np.abs(sensed - start))
    assert hardest < sarcos.joints[0].max_torque_nm
    assert np.all(np.rad2deg(moved) > 2.0)


@pytest.mark.campaign
def test_wild_arms_differ_from_the_paper_and_from_each_other():
    found = [paper_loop().offsets_rad, *(scenario("wild", k).truth.offsets_rad for k in range(6))]
    for k, x in enumerate(found):
        for y in found[:k]:
            assert np.abs(wrap_angle(x - y)).max() > np.deg2rad(3.0)


def test_wrong_calls_are_refused(sarcos):
    with pytest.raises(ValueError, match=", ".join(SCENARIOS)):
        scenario("nominal")
    with pytest.raises(ValueError, match="seed"):
        scenario("exact", -1)
    none = np.zeros(6)
    six = ArmModel(
        name="six",
        table=DhTable(theta_off_rad=none, s_m=none, a_m=none, alpha_rad=none),
        joints=sarcos.joints[:6],
        free=(),
        home_rad=none,
    )
    with pytest.raises(ValueError, match="7 joints"):
        scenario("exact").build(six)

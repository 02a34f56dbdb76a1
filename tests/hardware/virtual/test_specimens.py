"""Specimens drawn within the tolerances of the files: which parameters deviate, and by how much."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.virtual.scenarios import scenario_of
from hardware.virtual.specimens import draw_truth, files_allow
from hardware.virtual.true_loop import PAPER_HOME_RAD, paper_loop
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.parameters import DhEntry, DhKind
from solver.loops.dh import DhLoop
from solver.loops.endpoints import PointClosure
from tests.hardware.virtual.conftest import SARCOS, commands, sensed_rad

HINGE, RIGID = (load_fixture(name).fixture for name in ("hinge", "rigid"))
LONGER = replace(SARCOS, table=replace(SARCOS.table, s_m=SARCOS.table.s_m + 0.02 * np.eye(7)[2]))


@pytest.mark.parametrize("fixture", ["hinge", "rigid", "sarcos_ball"])
def test_remounting_changes_the_fixture_and_not_the_arm(fixture):
    placed = load_fixture(fixture).fixture
    scenarios = [scenario_of("datasheet", 3, SARCOS, placed, number) for number in (1, 2, 2, 3)]
    one, two, same, _ = (each.true_loop() for each in scenarios)
    assert max(np.abs(each.build(SARCOS).closure_error).max() for each in scenarios) < 1e-9
    assert np.array_equal(two.table.stacked(), same.table.stacked())
    model, limits = placed.model(SARCOS), placed.tolerance
    mounted = {*model.ground_side, *(() if placed.stays_on_hand else model.hand_side)}
    change = two.table.stacked() - one.table.stacked()
    for kind in DhKind:
        for row in range(8):
            name = DhEntry(kind, row).name
            limit = 2.0 * (limits.orientation_rad if kind.is_angle else limits.position_m)
            size = abs(float(change[kind, row]))
            assert size <= limit if name in mounted else size == 0.0, name
    if isinstance(one.loop, PointClosure) and isinstance(two.loop, PointClosure):
        assert np.array_equal(one.loop.tip_m, two.loop.tip_m)
        moved_m = np.abs(one.loop.ground_m - two.loop.ground_m).max()
        assert 1e-4 < moved_m < 2.0 * limits.position_m
    else:
        assert np.abs(change[DhKind.S]).max() > 1e-4


def test_deviations_of_all_parameters_are_within_their_tolerances():
    nominal, limits = RIGID.model(SARCOS).table.stacked(), RIGID.tolerance
    deviations = -nominal + [
        draw_truth(SARCOS, RIGID, np.random.default_rng(seed), maker_errors=True).table.stacked()
        for seed in range(40)
    ]
    offsets = np.rad2deg(np.abs(deviations[:, DhKind.THETA_OFF, 1:]))
    assert offsets.max() <= 3.0
    assert offsets[:, [0, 1, 2, 4, 5, 6]].max(axis=0).min() > 2.0
    # The elbow does not move, so its offset is not identifiable and has its nominal value.
    assert offsets[:, 3].max() == 0.0
    for name in ("a_0", "s_0", "alpha_0", "s_1"):
        entry = DhEntry.parse(name)
        largest = np.abs(deviations[:, entry.kind, entry.row]).max()
        limit = limits.orientation_rad if entry.kind.is_angle else limits.position_m
        assert 0.4 * limit < largest <= limit, name
    # Errors of the maker's table: about 0.5 mm and 0.1 deg.
    assert 0.4e-3 < deviations[:, DhKind.A, 1:].std() < 0.6e-3
    assert 0.08 < np.rad2deg(deviations[:, DhKind.ALPHA, 1:].std()) < 0.12


def test_without_maker_errors_the_table_is_nominal():
    ball = load_fixture("sarcos_ball").fixture
    truth = draw_truth(SARCOS, ball, np.random.default_rng(0), maker_errors=False).table.stacked()
    assert not truth[:, 0].any()
    nominal = truth[:, 1:] == SARCOS.table.stacked()
    assert nominal[DhKind.S :].all()
    # A ball hides the offsets of the first and the last joint.
    assert nominal[DhKind.THETA_OFF].tolist() == [True] + [False] * 5 + [True]


def test_paper_arm_is_used_only_for_files_that_allow_it():
    assert files_allow(SARCOS, HINGE, paper_loop(), PAPER_HOME_RAD)
    exact = replace(HINGE, tolerance=replace(HINGE.tolerance, position_m=1e-3))
    for arm, fixture in ((SARCOS, RIGID), (SARCOS, exact), (LONGER, HINGE)):
        assert not files_allow(arm, fixture, paper_loop(), PAPER_HOME_RAD)
    truth = scenario_of("exact", 0, LONGER, HINGE).truth
    assert isinstance(truth.loop, DhLoop)
    assert truth.table.s_m[3] == pytest.approx(0.375)
    table = scenario_of("exact", 0, SARCOS, HINGE).truth.table.stacked()
    assert np.array_equal(table, paper_loop().table.stacked())


@pytest.mark.parametrize("scenario", ["exact", "datasheet", "as_reported"])
def test_seed_gives_one_arm_for_all_fixtures(scenario):
    """Except for the mounting (zero of joint 1, last row) and the offset of an elbow that does not move."""
    names = ("hinge", "sarcos_ball", "rigid", "tracker", "hinge")
    fixtures = [load_fixture(name).fixture for name in names]
    hinge, ball, rigid, tracker, other = (
        scenario_of(scenario, seed, LONGER, fixture).true_loop().table.stacked()[:, 2:-1]
        for fixture, seed in zip(fixtures, (5, 5, 5, 5, 6), strict=True)
    )
    assert np.array_equal(hinge, ball)
    assert np.array_equal(hinge, tracker)
    rigid[DhKind.THETA_OFF, 2] = hinge[DhKind.THETA_OFF, 2]
    assert np.array_equal(hinge, rigid)
    nominal = LONGER.table.stacked()[:, 1:-1]
    assert np.abs(hinge - nominal)[DhKind.THETA_OFF].min() > 1e-3
    assert not np.isclose(hinge[DhKind.THETA_OFF], other[DhKind.THETA_OFF]).any()


def test_fixture_load_on_a_small_arm_is_within_its_torque_limits():
    """The load for an arm of 100 Nm took 7 of the 12 Nm of a Panda's wrist, and tripped it during moves."""
    panda = load_arm("franka_panda")
    ball = load_fixture("ball").fixture
    for seed in range(3):
        plant = scenario_of("as_reported", seed, panda, ball).build(panda)
        start = sensed_rad(plant)
        for _ in range(60):
            reading = plant.step(commands({j: start[j - 1] for j in (1, 5, 6, 7)}))
        for torque, joint in zip(reading.torque_nm, panda.joints, strict=True):
            assert abs(torque) < 0.25 * joint.max_torque_nm


def test_fixture_out_of_reach_is_refused():
    far = replace(HINGE, a_0_m=2.5)
    with pytest.raises(ValueError, match="no pose near the arm's home_deg"):
        draw_truth(SARCOS, far, np.random.default_rng(0), maker_errors=False)


def test_parallel_axes_get_a_twist_about_y_in_place_of_an_offset():
    parallel = replace(SARCOS, hayati_rows=(3,))
    plain, twisted = (
        draw_truth(arm, HINGE, np.random.default_rng(5), maker_errors=True)
        for arm in (SARCOS, parallel)
    )
    assert not plain.table.beta_rad.any()
    assert np.flatnonzero(twisted.table.beta_rad).tolist() == [3]
    assert abs(np.rad2deg(twisted.table.beta_rad[3])) < 0.5
    assert twisted.table.s_m[3] == SARCOS.table.s_m[2] != plain.table.s_m[3]
    assert files_allow(parallel, HINGE, twisted, parallel.home_rad)

"""Specimens drawn within the files' tolerances: what is off, by how much, and what is refused in words."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.ball import Ball
from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand
from hardware.virtual.scenarios import scenario_of
from hardware.virtual.specimens import SpecimenFiles, draw_truth, files_allow
from hardware.virtual.true_loop import PAPER_HOME_RAD, BallTruth, LoopTruth, Truth, paper_loop
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.parameters import DhEntry, DhKind
from tests.hardware.virtual.conftest import stated


def closes(truth: Truth, theta_rad: np.ndarray, theta_0_rad: float) -> float:
    point = truth.point()
    point.at(np.concatenate(([theta_0_rad], theta_rad)))
    return float(np.abs(point.error).max())


@pytest.mark.parametrize("fixture", ["hinge", "rigid", "sarcos_ball"])
def test_a_specimen_closes_and_is_the_same_for_a_seed(fixture):
    what = stated(fixture)
    one, same, other = (
        draw_truth(what, np.random.default_rng(seed), maker_errors=True) for seed in (3, 3, 4)
    )
    pose, hinge = one.closed_near(what.arm.home_rad)
    assert closes(one, pose, hinge) < 1e-9
    assert np.array_equal(one.table.stacked(), same.table.stacked())
    assert not np.array_equal(one.table.stacked(), other.table.stacked())


@pytest.mark.parametrize("fixture", ["hinge", "rigid", "sarcos_ball"])
def test_mounted_anew_the_arm_is_the_same_and_its_fixture_is_not(fixture):
    what = stated(fixture)
    one, two, same, three = (scenario_of("datasheet", 3, what, k).true_loop() for k in (1, 2, 2, 3))
    pose, hinge = two.closed_near(what.arm.home_rad)
    assert closes(two, pose, hinge) < 1e-9
    model = what.fixture.model(what.arm)
    own = {*model.ground_side, *(() if what.fixture.stays_on_hand else model.hand_side)}
    off = two.table.stacked() - one.table.stacked()
    assert np.array_equal(two.table.stacked(), same.table.stacked())
    assert closes(three, *three.closed_near(what.arm.home_rad)) < 1e-9
    for kind in DhKind:
        for row in range(8):
            name = DhEntry(kind, row).name
            limit = 2.0 * (what.tolerance_rad if kind.is_angle else what.tolerance_m)
            moved = abs(float(off[kind, row]))
            assert moved <= limit if name in own else moved == 0.0, name
    if isinstance(one, BallTruth) and isinstance(two, BallTruth):
        assert np.array_equal(one.tip_m, two.tip_m)
        assert 1e-4 < np.abs(one.ground_m - two.ground_m).max() < 2.0 * what.tolerance_m
    else:
        assert np.abs(off[DhKind.S]).max() > 1e-4


def test_everything_is_off_within_what_is_stated_and_nothing_else_is():
    what = stated("rigid")
    nominal = what.fixture.model(what.arm).table.stacked()  # type: ignore[attr-defined]
    off = np.array(
        [
            draw_truth(what, np.random.default_rng(seed), maker_errors=True).table.stacked()
            for seed in range(40)
        ]
    )
    off -= nominal
    offsets = np.rad2deg(np.abs(off[:, DhKind.THETA_OFF, 1:]))
    assert offsets.max() <= 3.0
    assert offsets[:, [0, 1, 2, 4, 5, 6]].max(axis=0).min() > 2.0
    # The elbow does not move: nothing could tell its offset, so it is what the file says.
    assert offsets[:, 3].max() == 0.0
    for name in ("a_0", "s_0", "alpha_0", "s_1"):
        entry = DhEntry.parse(name)
        size = np.abs(off[:, entry.kind, entry.row])
        limit = what.tolerance_rad if entry.kind.is_angle else what.tolerance_m
        assert 0.4 * limit < size.max() <= limit, name
    # What the maker states is off by about half a millimetre and a tenth of a degree.
    assert 0.4e-3 < off[:, DhKind.A, 1:].std() < 0.6e-3
    assert 0.08 < np.rad2deg(off[:, DhKind.ALPHA, 1:].std()) < 0.12


def test_without_makers_errors_the_table_is_the_files():
    what = stated("sarcos_ball")
    truth = draw_truth(what, np.random.default_rng(0), maker_errors=False)
    own = np.zeros((5, 8))
    own[:, 1:] = what.arm.table.stacked()
    same = truth.table.stacked() == own
    assert same[DhKind.S :].all()
    # A ball hides the offsets of the first and the last joint.
    assert same[DhKind.THETA_OFF].tolist() == [True, True] + [False] * 5 + [True]


def test_the_papers_own_arm_stands_in_only_for_files_that_may_mean_it():
    def paper(what: SpecimenFiles) -> bool:
        return files_allow(what, paper_loop(), PAPER_HOME_RAD)

    sarcos = load_arm("sarcos_dextrous")
    assert paper(stated("hinge"))
    assert not paper(stated("rigid"))
    assert not paper(stated("hinge", tolerance_m=1e-3))
    more = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
    longer = replace(sarcos, table=replace(sarcos.table, s_m=sarcos.table.s_m + more))
    assert not paper(stated("hinge", longer))
    truth = scenario_of("exact", 0, stated("hinge", longer)).truth
    assert isinstance(truth, LoopTruth)
    assert truth.table.s_m[3] == pytest.approx(0.375)
    own = scenario_of("exact", 0, stated("hinge")).truth.table.stacked()
    assert np.array_equal(own, paper_loop().table.stacked())


@pytest.mark.parametrize("scenario", ["exact", "datasheet", "as_reported"])
def test_for_one_seed_it_is_one_arm_whatever_holds_or_sees_its_hand(scenario):
    """But for what the mounting decides (joint 1's zero, the last row) and an elbow that does not move."""
    sarcos = load_arm("sarcos_dextrous")
    more = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
    mine = replace(sarcos, table=replace(sarcos.table, s_m=sarcos.table.s_m + more))
    hinge, ball, rigid, opened = (
        scenario_of(scenario, 5, stated(f, mine)).true_loop().table.stacked()[:, 2:-1]
        for f in ("hinge", "sarcos_ball", "rigid", "tracker")
    )
    assert np.array_equal(hinge, ball)
    assert np.array_equal(hinge, opened)
    rigid[DhKind.THETA_OFF, 2] = hinge[DhKind.THETA_OFF, 2]
    assert np.array_equal(hinge, rigid)
    nominal = mine.table.stacked()[:, 1:-1]
    assert np.abs(hinge - nominal)[DhKind.THETA_OFF].min() > 1e-3
    other = scenario_of(scenario, 6, stated("hinge", mine)).true_loop().table.stacked()[:, 2:-1]
    assert not np.isclose(hinge[DhKind.THETA_OFF], other[DhKind.THETA_OFF]).any()


def test_the_load_of_a_foreign_arm_is_one_that_its_drives_can_hold():
    """What bends the fixture of an arm of 100 Nm took 7 of the 12 Nm of a Panda's wrist, and tripped it on the way."""
    panda = load_arm("franka_panda")
    ball = Ball(tip_m=(0.06, -0.03, 0.08), ground_m=(0.37053, -0.02121, 0.51028))
    what = SpecimenFiles(arm=panda, fixture=ball, tolerance_m=0.03, tolerance_rad=np.deg2rad(10.0))
    for seed in range(3):
        plant = scenario_of("as_reported", seed, what).build(panda)
        start = plant.true_angles_rad[1:] - plant.truth.offsets_rad
        told = [
            JointCommand(
                mode=JointMode.POSITION if j in (1, 5, 6, 7) else JointMode.FREE, target_rad=q
            )
            for j, q in enumerate(start.tolist(), 1)
        ]
        for _ in range(60):
            reading = plant.step(told)
        for torque, joint in zip(reading.torque_nm, panda.joints, strict=True):
            assert abs(torque) < 0.25 * joint.max_torque_nm


def test_a_fixture_out_of_reach_is_refused_in_words():
    far = replace(stated("hinge"), fixture=replace(load_fixture("hinge").fixture, a_0_m=2.5))
    with pytest.raises(ValueError, match="no pose near the arm's home_deg"):
        draw_truth(far, np.random.default_rng(0), maker_errors=False)


def test_between_parallel_axes_a_twist_about_y_is_drawn_and_no_slide():
    sarcos = load_arm("sarcos_dextrous")
    arm = replace(sarcos, hayati_rows=(3,))
    both = [
        draw_truth(stated("hinge", one), np.random.default_rng(5), maker_errors=True)
        for one in (sarcos, arm)
    ]
    plain, twisted = (truth.table for truth in both)
    assert not plain.beta_rad.any()
    assert np.flatnonzero(twisted.beta_rad).tolist() == [3]
    assert abs(np.rad2deg(twisted.beta_rad[3])) < 0.5
    assert twisted.s_m[3] == sarcos.table.s_m[2] != plain.s_m[3]
    assert files_allow(stated("hinge", arm), both[1], arm.home_rad)

"""The open arm and the tracker that sees it, against plain matrices."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fixtures.measured import Measured
from fixtures.setup_checks import mounted_entries
from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand
from hardware.virtual.scenarios import scenario, scenario_of
from hardware.virtual.true_loop import OpenTruth, paper_loop
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.parameters import DhEntry
from tests.hardware.virtual.conftest import stated
from tests.oracles.loop_oracle import product

ARM = load_arm("sarcos_dextrous")
INSTRUMENT = load_fixture("tracker").fixture
assert isinstance(INSTRUMENT, Measured)


def test_it_is_the_arm_of_the_hinge_taken_out_of_it():
    chosen = scenario_of("datasheet", 3, stated("tracker"))
    truth, held = chosen.true_loop(), scenario("datasheet", 3).true_loop()
    assert isinstance(truth, OpenTruth)
    off = truth.table.stacked()[:, 1:] - held.table.stacked()[:, 1:]
    for name in mounted_entries(7):
        entry = DhEntry.parse(name)
        off[entry.kind, entry.row - 1] = 0.0
    assert np.array_equal(off, np.zeros((5, 7)))
    # The same errors of the maker's table as well, where a scenario has some.
    open_errors = scenario_of("as_reported", 3, stated("tracker")).true_loop().table.s_m[2:7]
    assert np.array_equal(open_errors, scenario("as_reported", 3).true_loop().table.s_m[2:7])
    assert np.abs(open_errors - paper_loop().table.s_m[2:7]).min() > 5e-4


def test_the_tracker_sees_the_target_where_the_matrices_have_it():
    chosen = scenario_of("exact", 1, stated("tracker"))
    plant, truth = chosen.build(ARM), chosen.true_loop()
    tracker = chosen.tracker(plant, INSTRUMENT)
    assert tracker is not None
    assert isinstance(truth, OpenTruth)
    constants = truth.table.stacked()[1:, 1:]
    hand = product(plant.true_angles_rad[None, 1:], *constants)[0]
    seen = json.loads(tracker.answer('{"measure": "4"}'))
    point = truth.base_rotation @ (hand @ np.append(truth.tip_m, 1.0))[:3] + truth.base_m
    assert seen["pose"] == "4"
    assert [seen[k] for k in ("x_m", "y_m", "z_m")] == pytest.approx(point, abs=1e-12)
    turned = Rotation.from_rotvec([seen[k] for k in ("rx_deg", "ry_deg", "rz_deg")], degrees=True)
    wanted = Rotation.from_matrix(truth.base_rotation @ hand[:3, :3] @ truth.tip_rotation)
    assert (turned * wanted.inv()).magnitude() < 1e-9
    for odd in ("what?", "[" * 4000):
        assert "measure" in json.loads(tracker.answer(odd))["error"]


def test_its_noise_is_what_the_fixture_file_states():
    chosen = scenario_of("datasheet", 1, stated("tracker"))
    tracker = chosen.tracker(chosen.build(ARM), INSTRUMENT)
    assert tracker is not None
    seen = np.array([tracker.measured() for _ in range(200)])
    place = seen[:, :3].std(axis=0, ddof=1)
    turns = Rotation.from_rotvec(seen[:, 3:])
    turn = (turns * turns.mean().inv()).as_rotvec().std(axis=0, ddof=1)
    # 200 draws tell a standard deviation to 5 %.
    assert place == pytest.approx(INSTRUMENT.sigma_m, rel=0.2)
    assert turn == pytest.approx(INSTRUMENT.sigma_rad, rel=0.2)


def test_nothing_holds_the_hand_so_what_is_not_driven_sags():
    plant = scenario_of("exact", 1, stated("tracker")).build(ARM)
    start = plant.true_angles_rad[1:]
    held = [
        JointCommand(mode=JointMode.POSITION, target_rad=float(q))
        for q in start - plant.truth.offsets_rad
    ]
    for _ in range(30):
        plant.step(held)
    assert np.abs(plant.true_angles_rad[1:] - start).max() < np.deg2rad(0.5)
    free = [replace(c, mode=JointMode.FREE) if j == 1 else c for j, c in enumerate(held)]
    for _ in range(30):
        plant.step(free)
    assert abs(plant.true_angles_rad[2] - start[1]) > np.deg2rad(5.0)
    assert plant.closure_error.size == 0

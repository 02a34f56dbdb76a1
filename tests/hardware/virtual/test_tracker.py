"""The open arm and its simulated tracker, against plain homogeneous matrices."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hardware.virtual.scenarios import scenario_of
from operator_app.config.fixture_file import load_fixture
from tests.hardware.virtual.conftest import SARCOS, commands, sensed_rad
from tests.oracles.loop_oracle import product

INSTRUMENT = load_fixture("tracker").fixture


def test_tracker_measures_the_pose_of_the_matrices():
    chosen = scenario_of("exact", 1, SARCOS, INSTRUMENT)
    plant, truth = chosen.build(SARCOS), chosen.true_loop()
    tracker = chosen.tracker(plant, INSTRUMENT)
    loop = truth.loop
    constants = truth.table.stacked()[1:, 1:]
    tool = product(plant.true_angles_rad[None, 1:], *constants)[0]
    answer = json.loads(tracker.answer('{"measure": "4"}'))
    point = loop.base_rotation @ (tool @ np.append(loop.tip_m, 1.0))[:3] + loop.base_m
    assert answer["pose"] == "4"
    assert [answer[k] for k in ("x_m", "y_m", "z_m")] == pytest.approx(point, abs=1e-12)
    measured = Rotation.from_rotvec(
        [answer[k] for k in ("rx_deg", "ry_deg", "rz_deg")], degrees=True
    )
    expected = Rotation.from_matrix(loop.base_rotation @ tool[:3, :3] @ loop.tip_rotation)
    assert (measured * expected.inv()).magnitude() < 1e-9
    for request in ("what?", "[" * 4000):
        assert "measure" in json.loads(tracker.answer(request))["error"]


def test_tracker_noise_has_the_sigmas_of_the_fixture_file():
    chosen = scenario_of("datasheet", 1, SARCOS, INSTRUMENT)
    tracker = chosen.tracker(chosen.build(SARCOS), INSTRUMENT)
    poses = np.array([tracker.measured() for _ in range(200)])
    rotations = Rotation.from_rotvec(poses[:, 3:])
    rotation_errors = (rotations * rotations.mean().inv()).as_rotvec()
    # The standard uncertainty of a standard deviation of 200 draws is 5 %.
    assert poses[:, :3].std(axis=0, ddof=1) == pytest.approx(INSTRUMENT.sigma_m, rel=0.2)
    assert rotation_errors.std(axis=0, ddof=1) == pytest.approx(INSTRUMENT.sigma_rad, rel=0.2)


def test_free_joint_of_the_open_arm_sags():
    plant = scenario_of("exact", 1, SARCOS, INSTRUMENT).build(SARCOS)
    start = plant.true_angles_rad[1:]
    targets = dict(enumerate(sensed_rad(plant), 1))
    for _ in range(30):
        plant.step(commands(targets))
    assert np.abs(plant.true_angles_rad[1:] - start).max() < np.deg2rad(0.5)
    del targets[2]
    for _ in range(30):
        plant.step(commands(targets))
    assert abs(plant.true_angles_rad[2] - start[1]) > np.deg2rad(5.0)
    assert plant.closure_error.size == 0

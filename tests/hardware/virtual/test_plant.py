from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest

from hardware.virtual.axis import JointSensor, PlantReading
from hardware.virtual.plant import Loads, Plant
from hardware.virtual.scenarios import STIFF
from hardware.virtual.true_loop import PAPER_HOME_RAD, Truth, paper_loop
from solver.arrays import FloatArray
from tests.hardware.virtual.conftest import BLOCKED, commands, sensed_rad
from tests.oracles.loop_oracle import product

FINE_RAD = 1e-9
RIGID = replace(STIFF, payload_kg=np.zeros(7))
SOFT = replace(RIGID, fixture_n_per_m=2e6, fixture_nm_per_rad=3e4)
LOADED = replace(SOFT, payload_kg=STIFF.payload_kg)


def make_plant(loads: Loads = SOFT) -> Plant:
    truth, sensor = paper_loop(), JointSensor(resolution_rad=FINE_RAD, noise_counts=0.0)
    return Plant(
        truth=truth,
        loads=loads,
        sensors=[sensor] * 7,
        rng=np.random.default_rng(0),
        start_rad=truth.closed_near(PAPER_HOME_RAD),
    )


def joint_angle(plant: Plant, joint: int) -> float:
    return float(sensed_rad(plant)[joint - 1])


def hold(plant: Plant, targets: Mapping[int, float], steps: int) -> PlantReading:
    for _ in range(steps):
        reading = plant.step(commands(targets))
    return reading


def move(plant: Plant, path_deg: FloatArray, *, ratio: float = -1.0) -> Iterator[PlantReading]:
    """Move joint 1 along the path, relative to its present angle, and joint 5 by `ratio` times as much."""
    angle_1, angle_5 = joint_angle(plant, 1), joint_angle(plant, 5)
    for x in np.deg2rad(path_deg).tolist():
        yield plant.step(commands({1: angle_1 + x, 5: angle_5 + ratio * x}))


def test_two_driven_joints_move_the_loop_and_return_it():
    plant = make_plant()
    start = plant.true_angles_rad
    quarter = np.linspace(0.0, 12.0, 150)
    path = np.concatenate((quarter, quarter[::-1], -quarter, -quarter[::-1], np.zeros(150)))
    farthest, largest_error = np.zeros(8), 0.0
    for _ in move(plant, path, ratio=-2.5):
        farthest = np.maximum(farthest, np.abs(plant.true_angles_rad - start))
        largest_error = max(largest_error, float(np.abs(plant.closure_error).max()))
    assert np.rad2deg(farthest[[1, 5]]) == pytest.approx([12.0, 30.0], abs=0.5)
    assert np.all(np.rad2deg(np.delete(farthest, [1, 5])) > 1.0)
    assert largest_error < 1e-3
    assert np.rad2deg(np.abs(plant.true_angles_rad - start).max()) < 1e-9


def test_loop_sags_with_one_driven_joint_and_not_with_two():
    def sag_deg(joints: tuple[int, ...]) -> float:
        plant = make_plant(LOADED)
        start = plant.true_angles_rad
        targets = {j: joint_angle(plant, j) for j in joints}
        hold(plant, targets, 100)
        return float(np.rad2deg(np.abs(plant.true_angles_rad - start).max()))

    assert sag_deg((1,)) > 5.0
    assert sag_deg((5,)) > 5.0
    assert sag_deg((1, 5)) < 0.5


def test_friction_above_the_load_prevents_creep():
    plant = make_plant(replace(LOADED, friction_nm=np.full(7, 30.0)))
    start = plant.true_angles_rad
    targets = {1: joint_angle(plant, 1)}
    hold(plant, targets, 200)
    settled = plant.true_angles_rad
    hold(plant, targets, 200)
    assert np.abs(settled - start).max() < 2e-3
    assert np.abs(plant.true_angles_rad - settled).max() < 1e-8


def test_friction_keeps_the_fixture_deflected_at_rest():
    def deflection_m(friction_nm: float) -> float:
        slender = replace(RIGID, fixture_n_per_m=1e5, fixture_nm_per_rad=3e3)
        plant = make_plant(replace(slender, friction_nm=np.full(7, friction_nm)))
        list(move(plant, np.minimum(np.arange(250) * 15.0 / 99.0, 15.0)))
        return float(np.linalg.norm(plant.closure_error[3:]))

    assert deflection_m(0.0) < 1e-9
    assert 1e-4 < deflection_m(5.0) < 3e-3


def test_gravity_torque_is_the_gradient_of_the_potential():
    """With a negligible fixture stiffness, holding joints carry the weight alone: torque = dV/dtheta."""
    payload = np.array([0.3, 0.0, 1.0, 0.2, 1.5, 0.0, 0.7])
    loose = replace(STIFF, fixture_n_per_m=1e-9, fixture_nm_per_rad=1e-9)
    plant = make_plant(replace(loose, payload_kg=payload))
    for _ in range(60):
        reading = plant.step(BLOCKED)
    angles, h = plant.true_angles_rad[1:], 1e-6
    gradient = [
        (
            potential(plant.truth, angles + h * e, payload)
            - potential(plant.truth, angles - h * e, payload)
        )
        / (2.0 * h)
        for e in np.eye(7)
    ]
    np.testing.assert_allclose(reading.torque_nm, gradient, rtol=0.0, atol=1e-6)
    assert np.abs(gradient).max() > 1.0


def potential(truth: Truth, joints: FloatArray, payload_kg: FloatArray) -> float:
    """Potential energy of the payload by plain homogeneous matrices in frame 0, J."""
    constants = truth.table.stacked()[1:, 1:]
    return sum(
        9.81 * mass * float(product(joints[:j], *constants[:, :j])[0, 3])
        for j, mass in enumerate(payload_kg, start=1)
    )


def test_blocked_valve_holds_the_joint():
    plant = make_plant(LOADED)
    list(move(plant, np.rad2deg(0.002) * np.arange(100), ratio=0.0))
    stopped = plant.true_angles_rad
    for _ in range(200):
        reading = plant.step([(None, 99.0)] * 7)
    assert np.rad2deg(np.abs(plant.true_angles_rad - stopped).max()) < 0.5
    assert max(map(abs, reading.speed_rad_per_s)) < 1e-6


def test_reading_is_of_the_state_after_the_step():
    plant = make_plant()
    before = plant.true_angles_rad
    (reading,) = move(plant, np.rad2deg([0.01]), ratio=0.0)
    after = plant.true_angles_rad
    measured = np.array(reading.position_counts) * FINE_RAD + plant.truth.offsets_rad
    np.testing.assert_allclose(measured, after[1:], rtol=0.0, atol=FINE_RAD)
    np.testing.assert_allclose(reading.speed_rad_per_s, (after - before)[1:] / 0.01, atol=1e-12)
    assert reading.torque_nm[0] > 0.0
    assert reading.torque_nm[1] == 0.0


def test_stretched_loop_speeds_up_free_joints_and_blocks_the_driven_one():
    """With joint 2 holding, the chain is straight before joint 4 has moved by 30 deg."""
    plant = make_plant()
    h2, h4 = joint_angle(plant, 2), joint_angle(plant, 4)
    fastest, hardest = 0.0, 0.0
    ramp = np.deg2rad(np.linspace(0.0, 30.0, 400))
    for x in ramp.tolist():
        reading = plant.step(commands({2: h2, 4: h4 + x}))
        fastest = max(fastest, *map(abs, reading.speed_rad_per_s))
        hardest = max(hardest, *map(abs, reading.torque_nm))
    assert np.all(np.isfinite(plant.true_angles_rad))
    assert joint_angle(plant, 4) < h4 + np.deg2rad(25.0)
    assert fastest > 4.0 * (ramp[1] / 0.01)
    assert hardest > 100.0


def test_slip_of_the_fixture_moves_the_tool_by_as_much():
    plant = make_plant(RIGID)
    targets = {1: joint_angle(plant, 1), 5: joint_angle(plant, 5)}
    plant.slip(1e-3)
    hold(plant, targets, 100)
    # The tool is 1 mm from its old place, along one axis only, and the loop is closed at the new place.
    point = plant.truth.point()
    point.at(plant.true_angles_rad)
    assert np.sort(np.abs(point.error)) == pytest.approx([0, 0, 0, 0, 0, 1e-3], abs=2e-6)
    assert np.abs(plant.closure_error).max() < 2e-6


def test_binding_hinge_blocks_two_driven_joints():
    moved_rad, torque_nm = [], []
    for bound in (False, True):
        plant = make_plant(RIGID)
        start = plant.true_angles_rad[0]
        if bound:
            plant.bind_hinge()
        *_, reading = move(plant, np.linspace(0.0, 5.0, 100))
        moved_rad.append(abs(plant.true_angles_rad[0] - start))
        torque_nm.append(max(map(abs, reading.torque_nm)))
    assert moved_rad[1] < 0.05 * moved_rad[0]
    assert torque_nm[1] > 100.0 > torque_nm[0]

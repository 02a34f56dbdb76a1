"""Registration of a tracker by poses that leave the place of its target uncertain."""

import numpy as np
import sarcal
from scipy.spatial.transform import Rotation

from operator_app.calibration.instrument_registration import (
    placed_by_poses,
    with_registered_instrument,
)
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.kinematics import forward
from solver.chain.rotations import rotation_matrix, rotation_vector
from tests.oracles.open_arm import write_measured_poses

BASE_M, TURN_RAD, TIP_M = np.array([0.8, -4.0, -0.3]), np.array([0.0, 0.0, 1.8]), [0.05, 0.02, 0.2]


def fixed_orientation_path(arm, count=30):
    """Joint angles (m, n) that keep the tool's orientation to 1e-4 deg: joint 4 compensates joints 2 and 3."""
    t, q = np.linspace(0.0, 2.0 * np.pi, count), np.tile(arm.home_rad, (count, 1))
    q[:, 1] += 0.2 * np.sin(t)
    q[:, 2] += 0.3 * np.sin(2.0 * t)
    q[:, 3] -= 0.2 * np.sin(t) + 0.3 * np.sin(2.0 * t)
    return q + np.random.default_rng(0).normal(0.0, np.deg2rad(1e-4), q.shape)


def test_target_stays_near_its_stated_place_with_one_orientation():
    arm, tracker = load_arm("ur5e"), load_fixture("tracker").fixture
    q, offsets_rad = fixed_orientation_path(arm), np.deg2rad([0.0, 0.05, -0.04, 0.06, -0.05, 0.0])
    frames = forward(q + arm.table.theta_off_rad + offsets_rad, *arm.table.stacked()[1:])
    turn, rng = rotation_matrix(TURN_RAD), np.random.default_rng(1)
    p = BASE_M + (frames.p_end + frames.R_end @ TIP_M) @ turn.T + rng.normal(0.0, 5e-5, (len(q), 3))
    endpoint = np.column_stack((p, rotation_vector(turn @ frames.R_end)))
    poses = sarcal.poses_of(q_rad=q, endpoint_m=endpoint)._set
    registered = with_registered_instrument(arm, tracker, poses)
    assert np.abs(np.subtract(registered.tip_m, tracker.tip_m)).max() < tracker.tolerance.position_m
    assert np.abs(registered.base_m - BASE_M).max() < tracker.tolerance.position_m
    assert np.abs(turn - rotation_matrix(np.array(registered.base_turn_rad))).max() < 0.01


def test_base_stays_near_where_all_points_are_nearly_on_a_line():
    arm, rng = load_arm("ur5e"), np.random.default_rng(1)
    q = np.tile(arm.home_rad, (40, 1))
    q[:, 2] += np.linspace(-1e-3, 1e-3, 40)
    frames = forward(q + arm.table.theta_off_rad, *arm.table.stacked()[1:])
    p = BASE_M + (frames.p_end + frames.R_end @ TIP_M) @ rotation_matrix(TURN_RAD).T
    poses = sarcal.poses_of(q_rad=q, endpoint_m=p + rng.normal(0.0, 1e-4, p.shape))._set
    placed = placed_by_poses(arm, load_fixture("tracker").fixture, poses, {})
    assert np.linalg.norm(np.subtract(placed.base_m, BASE_M)) < 2.0 * frames.p_end[0].max()


def matrix(document, name, station=0):
    """T_instrument_base or T_flange_target from its position and rotation vector."""
    place = document["instrument_placements"][station][name]
    T = np.eye(4)
    T[:3, 3] = place["position_m"]
    T[:3, :3] = Rotation.from_rotvec(place["rotation_vector_deg"], degrees=True).as_matrix()
    np.testing.assert_allclose(place["matrix"], T, rtol=0, atol=1e-12)
    return T


def test_base_is_reported_where_kabsch_finds_it(tmp_path):
    poses = sarcal.load_poses(write_measured_poses(tmp_path / "points.csv"))
    result = sarcal.calibrate(
        arm="sarcos_dextrous", fixture="tracker", poses=poses, drop_unidentifiable=True
    )
    document, measured = result.to_json(), poses._set.endpoint
    tip = document["instrument_placements"][0]["T_flange_target"]
    assert (tip["rotation_vector_deg"], tip["matrix"]) == (None, None)
    flange = result.fk(poses.q_rad, frame="flange", corrections=True)
    points = (flange @ np.append(tip["position_m"], 1.0))[:, :3]
    turn, _ = Rotation.align_vectors(measured - measured.mean(0), points - points.mean(0))
    T = matrix(document, "T_instrument_base")
    assert (Rotation.from_matrix(T[:3, :3]) * turn.inv()).magnitude() < 2e-4
    place = measured.mean(0) - turn.apply(points.mean(0))
    np.testing.assert_allclose(T[:3, 3], place, atol=2e-4)
    # base_r* are small turns from a registered orientation that is far from the file's.
    small = [document["parameters"].get(f"base_r{axis}", 0.0) for axis in "xyz"]
    assert Rotation.from_matrix(T[:3, :3]).magnitude() > 1.0
    assert np.linalg.norm(np.deg2rad(small)) < 0.02
    assert result.table("instrument").rows[0][1:4] == tuple(f"{1e3 * v:.3f}" for v in T[:3, 3])
    assert max(map(len, str(result.table("instrument")).splitlines())) <= 80


def test_planted_places_of_two_stations_and_the_target_are_reported():
    arm, rng = load_arm("ur5e"), np.random.default_rng(2)
    q = arm.home_rad + rng.uniform(-1.0, 1.0, (40, 6))
    frames = forward(q + arm.table.theta_off_rad, *arm.table.stacked()[1:])
    turns, at = Rotation.from_rotvec([[0.3, -0.2, 1.8], [-1.0, 0.9, -0.8]]), np.arange(40) // 20
    base, target = turns[at], Rotation.from_rotvec([1.2, 0.5, -0.7])
    stations_m = np.array([BASE_M, [3.0, 1.0, 0.2]])
    points = stations_m[at] + base.apply(frames.p_end + frames.R_end @ TIP_M)
    seen = (base * Rotation.from_matrix(frames.R_end) * target).as_rotvec()
    poses = sarcal.poses_of(q_rad=q, endpoint_m=np.hstack((points, seen)), placement=at + 1)
    result = sarcal.calibrate(arm="ur5e", fixture="tracker", poses=poses, drop_unidentifiable=True)
    assert result.accepted
    for k, turn in enumerate(turns):
        places = (("T_instrument_base", stations_m[k], turn), ("T_flange_target", TIP_M, target))
        for name, position, rotation in places:
            T = matrix(result.to_json(), name, k)
            np.testing.assert_allclose(T[:3, 3], position, atol=1e-3)
            assert (Rotation.from_matrix(T[:3, :3]) * rotation.inv()).magnitude() < 1e-3


def test_other_fixtures_have_no_instrument_placements(result):
    assert result.to_json()["instrument_placements"] == []
    assert "instrument" not in result.tables

"""Registration of a tracker by poses that leave the place of its target uncertain."""

import numpy as np

from operator_app.calibration.instrument_registration import (
    placed_by_poses,
    with_registered_instrument,
)
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.kinematics import forward
from solver.chain.poses import PoseSet
from solver.chain.rotations import rotation_matrix, rotation_vector

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
    q = fixed_orientation_path(arm)
    offsets_rad = np.deg2rad([0.0, 0.05, -0.04, 0.06, -0.05, 0.0])
    frames = forward(q + arm.table.theta_off_rad + offsets_rad, *arm.table.stacked()[1:])
    turn, rng = rotation_matrix(TURN_RAD), np.random.default_rng(1)
    p = BASE_M + (frames.p_end + frames.R_end @ TIP_M) @ turn.T + rng.normal(0.0, 5e-5, (len(q), 3))
    endpoint = np.column_stack((p, rotation_vector(turn @ frames.R_end)))
    poses = PoseSet(
        placement=np.ones(len(q), dtype=np.int64), label=tuple(map(str, range(len(q)))), q_rad=q,
        endpoint=endpoint,
    )  # fmt: skip
    registered = with_registered_instrument(arm, tracker, poses)
    assert np.abs(np.subtract(registered.tip_m, tracker.tip_m)).max() < tracker.tolerance.position_m
    assert np.abs(registered.base_m - BASE_M).max() < tracker.tolerance.position_m
    assert np.abs(turn - rotation_matrix(np.array(registered.base_turn_rad))).max() < 0.01


def test_base_stays_near_where_all_points_are_nearly_on_a_line():
    arm, tracker = load_arm("ur5e"), load_fixture("tracker").fixture
    q = np.tile(arm.home_rad, (40, 1))
    q[:, 2] += np.linspace(-1e-3, 1e-3, 40)
    frames = forward(q + arm.table.theta_off_rad, *arm.table.stacked()[1:])
    rng = np.random.default_rng(1)
    p = BASE_M + (frames.p_end + frames.R_end @ TIP_M) @ rotation_matrix(TURN_RAD).T
    poses = PoseSet(
        placement=np.ones(len(q), dtype=np.int64), label=tuple(map(str, range(len(q)))), q_rad=q,
        endpoint=p + rng.normal(0.0, 1e-4, p.shape),
    )  # fmt: skip
    placed = placed_by_poses(arm, tracker, poses, {})
    assert np.linalg.norm(np.subtract(placed.base_m, BASE_M)) < 2.0 * frames.p_end[0].max()

"""The error model of a pose set: approach sides from its times, and loads."""

from dataclasses import replace

import numpy as np
import pytest
import sarcal

from fixtures.base import RIGID
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.error_model import approach_of, averaged_at_rest, error_model
from operator_app.calibration.experiment import Experiment
from solver.chain.poses import PoseSet
from tests.oracles.as_shipped import ARM, HINGE, poses_of
from tests.oracles.identity import same
from tests.oracles.shop_floor import session


@pytest.fixture(scope="module")
def poses():
    return poses_of(session(1))


def side_of(poses, rows=None):
    return approach_of(ARM, poses, np.arange(len(poses)) if rows is None else rows)


def test_approach_side_follows_the_motion_between_poses(poses):
    side = side_of(poses)
    moved = np.diff(poses.q_rad, axis=0)
    far = np.abs(moved) > np.deg2rad(1.0)
    np.testing.assert_array_equal(side[1:][far], np.sign(moved)[far])
    assert not side[0].any()
    still = np.abs(moved) < np.deg2rad(0.01)
    np.testing.assert_array_equal(side[1:][still], side[:-1][still])
    two_placements = replace(poses, placement=np.repeat([1, 2], len(poses) // 2))
    assert not side_of(two_placements)[len(poses) // 2].any(), "it restarts with each placement"


def test_approach_side_ignores_file_order_and_uses_left_out_poses(poses):
    side = side_of(poses)
    shuffle = np.random.default_rng(0).permutation(len(poses))
    np.testing.assert_array_equal(side_of(poses.at_poses(shuffle)), side[shuffle])
    rows = np.array([3, 4, 9])
    np.testing.assert_array_equal(side_of(poses, rows), side[rows])
    # Duplicates under other labels are allowed.
    rows = np.array([*range(len(poses)), 5])
    twice = PoseSet(
        placement=poses.placement[rows],
        label=tuple(map(str, range(len(rows)))),
        q_rad=poses.q_rad[rows],
        utc=tuple(poses.utc[k] for k in rows),
    )
    np.testing.assert_array_equal(side_of(twice, rows[:-1]), side)


@pytest.mark.parametrize("first", ["", "yesterday", "2026-05-04T09:00:00"])
def test_approach_side_is_unknown_without_all_times_in_order(poses, first):
    for utc in (None, (first, *poses.utc[1:]), poses.utc[:1] * len(poses)):
        assert side_of(replace(poses, utc=utc)) is None


def rows_of(q_deg, placement, **columns):
    q_rad = np.deg2rad(np.array(q_deg)[:, None] * np.ones(7))
    return sarcal.poses_of(q_rad=q_rad, placement=placement, **columns)._set


def test_rows_of_an_arm_at_rest_get_their_mean():
    half_turn = np.pi - 1e-4
    endpoint = np.zeros((6, 6))
    endpoint[:3, 3] = half_turn, -half_turn, half_turn + 3e-4
    endpoint[:3, 0] = 0.0, 3e-4, 6e-4
    # At rest, in another placement, after a motion, and twice the same row.
    rows = rows_of(
        [10.0, 10.02, 10.04, 10.04, 20.0, 20.0],
        [1, 1, 1, 2, 2, 2],
        samples=np.array([1, 2, 3, 4, 5, 5]),
        endpoint_m=endpoint,
    )
    averaged = averaged_at_rest(ARM, rows)
    np.testing.assert_allclose(
        np.rad2deg(averaged.q_rad[:, 0]), [10.02, 10.02, 10.02, 10.04, 20.0, 20.0], atol=1e-9
    )
    assert averaged.samples.tolist()[:4] == [6, 6, 6, 4]
    np.testing.assert_allclose(averaged.endpoint[:3, 0], 3e-4)
    np.testing.assert_allclose(np.abs(averaged.endpoint[:3, 3]), np.pi, atol=2e-4)
    assert averaged_at_rest(ARM, averaged) is averaged
    still = replace(rows, q_rad=np.ones_like(rows.q_rad))
    assert len(np.unique(averaged_at_rest(ARM, still).endpoint[:3, 0])) == 1
    far = replace(rows, endpoint=endpoint * [10.0, 1, 1, 1, 1, 1])
    assert averaged_at_rest(ARM, far) is far, "the tool moved, whatever the joints read"


def test_slow_motion_is_no_rest():
    slow = rows_of(np.arange(0.0, 2.0, 0.03), [1] * 67)
    assert len(np.unique(averaged_at_rest(ARM, slow).q_rad[:, 0])) > 20


def test_loads_need_masses_and_compliance(poses):
    experiment = Experiment(arm=ARM, fixture=HINGE, poses=poses)
    assert error_model(experiment).loads.all_deflections.any()
    # Sag follows gravity; the load of the fixture is unknown.
    unstated = error_model(replace(experiment, arm=replace(ARM, masses=None))).loads
    assert unstated.joints.columns.any()
    turned = replace(ARM, masses=None, down=(0.0, 1.0, 0.0))
    columns = error_model(replace(experiment, arm=turned)).loads.joints.columns
    assert not np.allclose(columns, unstated.joints.columns), "sag follows the stated gravity"
    assert not unstated.all_deflections.any()
    rigid = replace(HINGE, compliance=RIGID)
    assert not error_model(replace(experiment, fixture=rigid)).loads.all_deflections.any()


@pytest.mark.parametrize("estimator", ["paper", "implicit"])
@pytest.mark.parametrize("seed", range(3))
def test_estimate_is_independent_of_pose_order(poses, estimator, seed):
    shuffle = np.random.default_rng(seed).permutation(len(poses))
    one, other = (
        calibrate(ARM, HINGE, p, estimator=estimator) for p in (poses, poses.at_poses(shuffle))
    )
    for name in ("x", "covariance", "chi2"):
        assert same(getattr(other.estimate, name), getattr(one.estimate, name))
    for name in ("position_m", "orientation_rad"):
        # The closure of the paper's estimator is summed in the caller's order.
        rms = [getattr(r.estimate.sigmas, name).rms for r in (other, one)]
        assert rms[0] == pytest.approx(rms[1], rel=1e-12)
    by_pose = ("residual", "pose_chi2", "corrections")
    for name in by_pose if estimator == "implicit" else by_pose[:1]:
        expected = getattr(one.estimate, name)[shuffle]
        np.testing.assert_allclose(getattr(other.estimate, name), expected, rtol=1e-12)
    if estimator == "implicit":
        assert same(*([c.sd for c in s.components.components] for s in (one, other)))

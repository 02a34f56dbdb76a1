from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from solver.chain.kinematics import DhTable
from solver.chain.parameters import nominal_vector
from solver.design.manifold import candidate_poses, grow_manifold
from solver.design.motion import Ranges
from solver.loops.dh import DhLoop
from tests.oracles.loop_oracle import closed_poses, closure, paper_truth, product
from tests.solver.conftest import entries
from tests.solver.design.conftest import REGION_STEP_RAD

TRUTH = paper_truth()


def test_every_pose_closes_and_is_in_range(region, ranges):
    angles = np.concatenate((region.u[:, :1], region.q), axis=1)
    assert np.abs(closure(TRUTH, angles)).max() < 1e-8
    T = product(angles + TRUTH.theta_off, TRUTH.s, TRUTH.a, TRUTH.alpha)
    assert np.trace(T[:, :3, :3], axis1=1, axis2=2).min() > 2.99
    assert ranges.clearance(region.q).min() >= 0.0


def test_region_covers_random_closed_poses(region, ranges):
    # Poses of the oracle: random joint angles brought onto the loop.
    random = closed_poses(TRUTH, np.random.default_rng(0), 150, spread_deg=40.0)[:, 1:]
    in_range = random[ranges.clearance(random) > 0.15]
    gap, _ = cKDTree(region.q).query(in_range)
    # The manifold has other parts that cannot be reached from home; most random poses are on this one.
    assert len(in_range) > 60
    assert np.mean(gap < REGION_STEP_RAD) > 0.9


def test_poses_are_evenly_spaced(region):
    nearest = cKDTree(region.q).query(region.q, k=2)[0][:, 1]
    assert nearest.min() > 0.7 * REGION_STEP_RAD
    assert np.percentile(nearest, 95) < 1.1 * REGION_STEP_RAD


def test_number_of_poses_is_near_the_requested_or_limited(loop, x, ranges):
    assert 600 < candidate_poses(loop, x, TRUTH.home, ranges, count=800).size < 1000
    assert grow_manifold(loop, x, TRUTH.home, ranges, most=50).size == 50


def test_start_that_does_not_close_is_rejected(loop, x, ranges):
    too_long = replace(
        loop, table=replace(loop.table, s_m=loop.table.s_m + 2.0 * (np.arange(8) == 1))
    )
    with pytest.raises(ValueError, match="does not close"):
        grow_manifold(too_long, nominal_vector(too_long.parameters), TRUTH.home, ranges)


def test_rigid_fixture_gives_a_curve(loop, x, region, ranges):
    """With the hinge fixed, one degree of freedom is left; growth follows it in both directions."""
    offsets = np.array(loop.table.theta_off_rad)
    offsets[0] = region.u[0, 0]
    rigid = replace(loop, table=replace(loop.table, theta_off_rad=offsets), hinge=False)
    curve = grow_manifold(rigid, x, TRUTH.home, ranges, step_rad=0.1)
    assert curve.motion.degrees == 1
    assert curve.size > 15
    moved = curve.q - curve.q[0]
    assert moved[:, 6].min() < -0.1
    assert moved[:, 6].max() > 0.1
    # Self-motion of an arm with a fixed tool: the elbow does not move.
    assert np.abs(moved[:, 3]).max() < 1e-9
    # On a curve, no pose has many neighbours.
    assert np.bincount(curve.neighbours.ravel(), minlength=curve.size).max() <= 4


def test_curve_is_followed_where_the_hinge_moves_most():
    """Six joints and a hinge that turns by 0.8 of every step: growth once ended at its start."""
    table = DhTable(
        theta_off_rad=np.deg2rad([0.0, 58.436, 0.0, 180.0, 0.0, 0.0, 102.891]),
        s_m=np.array([-133.38, -640.4, 7.0, 0.0, 127.0, -100.0, 97.4]) / 1e3,
        a_m=np.array([114.14, 10.0, 425.0, -392.0, 0.0, 0.0, -90.98]) / 1e3,
        alpha_rad=np.deg2rad([103.903, -90.0, 0.0, 0.0, -88.854, 95.711, 74.806]),
    )
    six = DhLoop(table=table, entries=entries(["theta_off_2"]), hinge=True, unsensed_joints=())
    home = np.deg2rad([-60.0, -79.0, -61.0, 5.0, 82.0, 153.0])
    wide = Ranges(lower_rad=home - np.pi, upper_rad=home + np.pi)
    curve = grow_manifold(six, nominal_vector(six.parameters), home, wide, step_rad=0.1)
    assert curve.motion.degrees == 1
    assert np.abs(curve.motion.tangent[0, 6, 0]) > 0.75
    assert 50 < curve.size < 8000
    assert np.bincount(curve.neighbours.ravel(), minlength=curve.size).min() >= 1

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from solver.chain.kinematics import DhTable
from solver.chain.parameters import entries, nominal_vector
from solver.design.manifold import candidate_poses, grow_manifold
from solver.design.motion import Ranges
from solver.loops.dh import DhLoop
from tests.oracles.loop_oracle import closed_poses, closure, paper_truth, product
from tests.solver.design.conftest import REGION_STEP_RAD

TRUTH = paper_truth()


def test_every_pose_closes_for_the_oracle_and_is_in_range(region, ranges):
    error = closure(TRUTH, np.concatenate((region.u[:, :1], region.q), axis=1))
    assert np.abs(error).max() < 1e-8
    T = product(
        np.concatenate((region.u[:, :1], region.q), axis=1) + TRUTH.theta_off,
        TRUTH.s,
        TRUTH.a,
        TRUTH.alpha,
    )
    assert np.trace(T[:, :3, :3], axis1=1, axis2=2).min() > 2.99
    assert ranges.clearance(region.q).min() >= 0.0


def test_region_covers_what_random_search_finds(region, ranges):
    # Poses of the oracle, projected from random joint angles: a way that knows no growth.
    found = closed_poses(TRUTH, np.random.default_rng(0), 150, spread_deg=40.0)[:, 1:]
    inside = found[ranges.clearance(found) > 0.15]
    gap, _ = cKDTree(region.q).query(inside)
    # The manifold has other parts that cannot be reached from home; most random poses are on this.
    assert len(inside) > 60
    assert np.mean(gap < REGION_STEP_RAD) > 0.9


def test_spacing_is_even(region):
    nearest = cKDTree(region.q).query(region.q, k=2)[0][:, 1]
    assert nearest.min() > 0.7 * REGION_STEP_RAD
    assert np.percentile(nearest, 95) < 1.1 * REGION_STEP_RAD


def test_same_seed_same_poses(loop, x, ranges):
    first, again, other = (
        grow_manifold(loop, x, TRUTH.home, ranges, step_rad=0.3, seed=s) for s in (4, 4, 5)
    )
    assert np.array_equal(first.q, again.q)
    assert first.q.shape != other.q.shape or not np.array_equal(first.q, other.q)


def test_candidates_come_in_the_number_asked_for(loop, x, ranges):
    assert 600 < candidate_poses(loop, x, TRUTH.home, ranges, count=800).size < 1000


def test_growth_stops_at_its_limit(loop, x, ranges):
    cut = grow_manifold(loop, x, TRUTH.home, ranges, most=50)
    assert cut.size == 50


def test_start_that_cannot_close_is_refused(loop, x, ranges):
    apart = replace(loop, table=replace(loop.table, s_m=loop.table.s_m + 2.0 * (np.arange(8) == 1)))
    with pytest.raises(ValueError, match="does not close"):
        grow_manifold(apart, nominal_vector(apart.parameters), TRUTH.home, ranges)


def test_rigid_fixture_leaves_a_curve(loop, x, region, ranges):
    """With the hinge locked where it stands one freedom is left; growth follows it both ways."""
    offsets = np.array(loop.table.theta_off_rad)
    offsets[0] = region.u[0, 0]
    rigid = replace(loop, table=replace(loop.table, theta_off_rad=offsets), hinge=False)
    curve = grow_manifold(rigid, x, TRUTH.home, ranges, step_rad=0.1)
    assert curve.motion.degrees == 1
    assert curve.size > 15
    moved = curve.q - curve.q[0]
    assert moved[:, 6].min() < -0.1
    assert moved[:, 6].max() > 0.1
    # The self-motion of a bolted arm: the elbow does not take part (method, section 2).
    assert np.abs(moved[:, 3]).max() < 1e-9
    # A curve: nobody has many neighbours.
    assert np.bincount(curve.neighbours.ravel(), minlength=curve.size).max() <= 4


def test_a_curve_is_followed_where_the_hinge_turns_most():
    """Six joints in a hinge: here it turns by 0.8 of every step, and growth ended where it began."""
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
    # Whoever stands on it has a neighbour on either side.
    assert np.bincount(curve.neighbours.ravel(), minlength=curve.size).min() >= 1

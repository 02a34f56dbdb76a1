"""Ball and measured endpoint against homogeneous matrices; D-H entries of a constrained frame."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver.chain.kinematics import DhTable
from solver.chain.parameters import nominal_vector
from solver.chain.rotations import rotation_matrix
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.loops.endpoint_geometry import constrained_frame_entries
from solver.loops.endpoints import PointClosure
from tests.contracts.planted import measured
from tests.oracles.loop_oracle import Truth, paper_truth, product
from tests.solver.conftest import entries, paper_arm, tip_position


def columns(seed: int) -> tuple[np.ndarray, ...]:
    """Random theta_off, s, a, alpha of six links."""
    rng = np.random.default_rng(seed)
    return tuple(rng.uniform(-1.0, 1.0, 6) for _ in range(4))


def test_ball_position_agrees_with_matrices():
    off, s, a, alpha = columns(0)
    tip, ground = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.5, -0.6])
    model = PointClosure(
        table=DhTable(theta_off_rad=off, s_m=s, a_m=a, alpha_rad=alpha),
        entries=entries(["theta_off_2", "a_3"]),
        tip_m=tip,
        ground_m=ground,
    )
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (5, 6))
    x = nominal_vector(model.parameters)
    expected = (product(q + off, s, a, alpha) @ np.append(tip, 1.0))[:, :3]
    np.testing.assert_allclose(model.reduced(x, q).residual, expected - ground, atol=1e-14)
    np.testing.assert_allclose(tip_position(model, x, q), expected, atol=1e-14)
    assert model.reduced(x, q).rotation_rows == 0
    points, axis = model.drawn(x, q[0])
    np.testing.assert_allclose(points[-1], expected[0], atol=1e-14)
    np.testing.assert_array_equal(model.fixture_axis(x)[0], ground)
    assert len(points) == 8
    assert not axis.any()


def test_measured_endpoint_agrees_with_matrices():
    arm = paper_arm(paper_truth())
    fixture = measured(arm)
    model = fixture.model(arm)
    q = np.random.default_rng(2).uniform(-3.0, 3.0, (5, 7))
    x = nominal_vector(model.parameters)
    t = arm.table

    def pose(rotation_vector, position_m):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotation_vector).as_matrix(), position_m
        return T

    expected = (
        pose(fixture.base_turn_rad, fixture.base_m)
        @ product(q + t.theta_off_rad, t.s_m, t.a_m, t.alpha_rad)
        @ pose(fixture.tip_turn_rad, fixture.tip_m)
    )
    position, rotation = model.predicted(x, q)
    np.testing.assert_allclose(position, expected[:, :3, 3], atol=1e-14)
    np.testing.assert_allclose(rotation, expected[:, :3, :3], atol=1e-14)
    with_measurements = model.with_endpoints(position, rotation)
    assert np.abs(with_measurements.reduced(x, q).residual).max() < 1e-14


@pytest.mark.parametrize("full_pose", [True, False])
def test_measurements_are_weighted_by_the_instruments_noise(full_pose):
    """chi2 and standard deviations are right where joint noise is far below instrument noise."""
    arm = paper_arm(paper_truth())
    arm = replace(arm, free=entries([f"theta_off_{j}" for j in range(2, 7)]))
    fixture = replace(measured(arm), full_pose=full_pose, sigma_m=2e-4, sigma_rad=1e-3)
    rng = np.random.default_rng(3)
    model = fixture.model(arm)
    truth = nominal_vector(model.parameters) + rng.uniform(-0.02, 0.02, len(model.parameters))
    sigma = np.full(7, 5e-5)
    chi2, deviations = [], []
    for _ in range(20):
        q = arm.home_rad + rng.uniform(-0.8, 0.8, (20, 7))
        position, rotation = model.predicted(truth, q)
        position = position + fixture.sigma_m * rng.normal(size=position.shape)
        jitter = rotation_matrix(fixture.sigma_rad * rng.normal(size=position.shape))
        with_measurements = model.with_endpoints(position, jitter @ rotation if full_pose else None)
        noise = NoiseModel(joint_variance=sigma**2, fixture_variance=fixture.endpoint_variance())
        estimate = estimate_implicit(with_measurements, q + sigma * rng.normal(size=q.shape), noise)
        assert estimate.converged
        chi2.append(estimate.chi2_per_dof)
        deviations.append((estimate.x - truth) / estimate.standard_deviation)
    # 20 runs of some 46 or 103 degrees of freedom: four standard deviations of the mean.
    assert abs(np.mean(chi2) - 1.0) < 4.0 * np.sqrt(2.0 / (20 * estimate.dof))
    assert 0.85 < np.sqrt(np.mean(np.square(deviations))) < 1.15


def test_measurements_follow_the_selected_poses():
    arm = paper_arm(paper_truth())
    model = measured(arm).model(arm)
    q = np.random.default_rng(4).uniform(-1.0, 1.0, (6, 7))
    x = nominal_vector(model.parameters)
    with pytest.raises(ValueError, match="no endpoint measurements"):
        model.reduced(x, q)
    position, rotation = model.predicted(x, q)
    with pytest.raises(ValueError, match="orientations"):
        model.with_endpoints(position)
    with_measurements = model.with_endpoints(position, rotation)
    with pytest.raises(ValueError, match="5 poses for 6"):
        with_measurements.reduced(x, q[:5])
    picked = np.array([4, 0, 2])
    assert np.abs(with_measurements.at_poses(picked).reduced(x, q[picked]).residual).max() < 1e-14
    assert np.abs(with_measurements.at_poses(picked).reduced(x, q[:3]).residual).max() > 0.1


@pytest.mark.parametrize("seed", range(5))
def test_constrained_frame_entries_close_the_loop(seed):
    rng = np.random.default_rng(seed)
    off, s, a, alpha = columns(seed)
    q = rng.uniform(-3.0, 3.0, 6)
    off[0] = off[-1] = s[0] = s[-1] = a[-1] = alpha[-1] = 0.0
    T = product(q + off, s, a, alpha)
    entries_by_name = constrained_frame_entries(T[:3, :3], T[:3, 3], 6)
    arm = Truth(*(np.append(0.0, column) for column in (off, s, a, alpha)), home=q)
    loop = arm.with_values(entries_by_name.keys(), entries_by_name.values())
    closed = product(np.append(0.0, q) + loop.theta_off, loop.s, loop.a, loop.alpha)
    np.testing.assert_allclose(closed, np.eye(4), atol=1e-11)

"""The fast kinematics of the plant against the kinematics of the solver."""

import numpy as np
import pytest

from hardware.virtual.loop_point import LoopPoint
from hardware.virtual.true_loop import PAPER_HOME_RAD, Truth, hinge_truth, paper_loop
from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable
from solver.loops.dh import DhLoop
from solver.loops.point import PointClosure


def general_loop() -> Truth:
    """A loop with no entry at zero, so that every term has an effect."""
    paper = paper_loop().table
    rng = np.random.default_rng(3)
    return hinge_truth(
        DhTable(
            theta_off_rad=paper.theta_off_rad,
            s_m=paper.s_m + 0.01 * rng.standard_normal(8),
            a_m=paper.a_m + 0.01 * rng.standard_normal(8),
            alpha_rad=paper.alpha_rad + 0.01 * rng.standard_normal(8),
            beta_rad=0.01 * rng.standard_normal(8),
        )
    )


def closed_angles(truth: Truth) -> FloatArray:
    joints, hinge = truth.closed_near(PAPER_HOME_RAD)
    return np.concatenate(([hinge], joints))


@pytest.mark.sample(6)
@pytest.mark.parametrize("truth", [paper_loop(), general_loop()], ids=["paper", "general"])
@pytest.mark.parametrize("spread_rad", [0.0, 1e-12, 1e-8, 2e-5, 1e-4, 1e-2, 0.3])
def test_error_and_jacobian_agree_with_the_solver(truth, spread_rad):
    rng = np.random.default_rng(1)
    point, loop, offsets = LoopPoint(truth.table), truth.loop, truth.offsets_rad
    for _ in range(20):
        angles = closed_angles(truth) + spread_rad * rng.standard_normal(8)
        point.at(angles)
        reference = loop.loop(np.zeros(0), (angles[1:] - offsets)[None], angles[None, :1])
        np.testing.assert_allclose(point.error, reference.residual[0], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(
            point.jacobian,
            np.concatenate((reference.jac_u[0], reference.jac_q[0]), axis=-1),
            rtol=0.0,
            atol=1e-12,
        )


def test_loop_open_by_half_a_turn_is_refused():
    flat = DhTable(
        theta_off_rad=np.zeros(2), s_m=np.zeros(2), a_m=np.ones(2), alpha_rad=np.zeros(2)
    )
    with pytest.raises(ValueError, match="half a turn"):
        LoopPoint(flat).at(np.array([0.0, np.pi]))


@pytest.mark.parametrize("kind", ["rigid", "ball"])
def test_loop_without_hinge_agrees_with_the_solver(kind):
    rng = np.random.default_rng(5)
    table = general_loop().table
    tip, ground = rng.normal(size=3), rng.normal(size=3)
    truth = Truth(DhLoop(table=table, entries=(), hinge=False))
    if kind == "ball":
        arm = DhTable.from_stacked(table.stacked()[:, 1:])
        truth = Truth(PointClosure(table=arm, entries=(), own=(), tip_m=tip, ground_m=ground))
    theta = rng.normal(size=table.links)
    theta[0] = 0.0
    point = truth.point()
    point.at(theta)
    q = (theta - table.theta_off_rad)[None, 1:]
    expected = truth.loop.loop(np.zeros(0), q, np.zeros((1, 0)))
    assert np.abs(point.error - expected.residual[0]).max() < 1e-12
    assert np.abs(point.jacobian[:, 1:] - expected.jac_q[0]).max() < 1e-12
    assert not point.jacobian[:, 0].any()

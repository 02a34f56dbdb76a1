"""The fast kinematics of the plant against the kinematics of the solver."""

import numpy as np
import pytest

from hardware.virtual.true_loop import PAPER_HOME_RAD, LoopPoint, Truth, hinge_truth, paper_loop
from solver.chain.kinematics import DhTable
from solver.loops.dh import DhLoop
from solver.loops.endpoints import PointClosure


def general_loop(kind: str = "hinge") -> Truth:
    """A loop with no entry at zero, so that every term has an effect."""
    rng = np.random.default_rng(3)
    deviations = 0.01 * rng.standard_normal((5, 8))
    deviations[0] = 0.0  # of the offsets
    table = DhTable.from_stacked(paper_loop().table.stacked() + deviations)
    if kind == "rigid":
        return Truth(DhLoop(table=table, entries=(), hinge=False))
    if kind == "ball":
        arm = DhTable.from_stacked(table.stacked()[:, 1:])
        tip_m, ground_m = rng.normal(size=(2, 3))
        return Truth(PointClosure(table=arm, entries=(), own=(), tip_m=tip_m, ground_m=ground_m))
    return hinge_truth(table)


LOOPS = {"paper": paper_loop()} | {kind: general_loop(kind) for kind in ("hinge", "rigid", "ball")}


@pytest.mark.sample(8)
@pytest.mark.parametrize("kind", LOOPS)
@pytest.mark.parametrize("spread_rad", [0.0, 1e-12, 1e-8, 2e-5, 1e-4, 1e-2, 0.3])
def test_error_and_jacobian_agree_with_the_solver(kind, spread_rad):
    rng = np.random.default_rng(1)
    truth, hinged = LOOPS[kind], LOOPS["paper" if kind == "paper" else "hinge"]
    own = kind in ("paper", "hinge")  # the hinge's angle is a coordinate
    closed = hinged.closed_near(PAPER_HOME_RAD)
    point = truth.point()
    for _ in range(20):
        angles = closed + spread_rad * rng.standard_normal(8)
        angles[0] *= own
        point.at(angles)
        q = (angles[1:] - truth.offsets_rad)[None]
        expected = truth.loop.loop(np.zeros(0), q, angles[None, :own])
        jacobian = np.concatenate((expected.jac_u[0], expected.jac_q[0]), axis=-1)
        np.testing.assert_allclose(point.error, expected.residual[0], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(point.jacobian[:, 1 - own :], jacobian, rtol=0.0, atol=1e-12)
        assert own or not point.jacobian[:, 0].any()


def test_loop_open_by_half_a_turn_is_refused():
    flat = DhTable(
        theta_off_rad=np.zeros(2), s_m=np.zeros(2), a_m=np.ones(2), alpha_rad=np.zeros(2)
    )
    with pytest.raises(ValueError, match="half a turn"):
        LoopPoint(flat).at(np.array([0.0, np.pi]))

"""Loop closure, elimination of the hinge angle and Jacobians against pinocchio and central differences."""

import numpy as np
import pinocchio as pin
import pytest

from solver.chain.parameters import nominal_vector
from solver.loops.dh import DhLoop
from tests.oracles.loop_oracle import closed_poses, paper_truth, product
from tests.oracles.pinocchio_chain import PinocchioChain
from tests.solver.conftest import NAMES, loop_of

HARD_ERRORS = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 0.9e-4, 1e-4, 1.1e-4, 1e-2, 0.3)
ALL_ENTRIES = tuple(f"{kind}_{j}" for kind in ("theta_off", "s", "a", "alpha") for j in range(1, 8))
TRUTH = paper_truth()
CLOSED = closed_poses(TRUTH, np.random.default_rng(0), 8)
U, Q = CLOSED[:, :1], CLOSED[:, 1:]


def perturbed(model: DhLoop, size: float, seed: int = 0) -> np.ndarray:
    direction = np.random.default_rng(seed).normal(size=len(model.parameters))
    return nominal_vector(model.parameters) + size * direction / np.linalg.norm(direction)


def central(f, x: np.ndarray, h: float = 1e-6) -> np.ndarray:
    steps = h * np.eye(len(x))
    return np.stack([(f(x + d) - f(x - d)) / (2.0 * h) for d in steps], axis=-1)


@pytest.mark.parametrize("size", [0.0, 0.01, 0.3])
def test_drawn_gap_is_the_misclosure(size):
    model = loop_of(TRUTH)
    x = perturbed(model, size)
    pin_m, axis = model.fixture_axis(x)
    table = model.tables(x)
    for angles in CLOSED:
        points, hand_axis = model.drawn(x, angles[1:])
        # In frame 0, which the hinge angle does not move.
        T = product(np.concatenate(([0.0], angles[1:])) + table[0], *table[1:])
        assert np.linalg.norm(points[-1] - pin_m) == pytest.approx(
            np.linalg.norm(T[:3, 3]), abs=1e-12
        )
        assert hand_axis @ axis == pytest.approx(T[2, 2], abs=1e-12)
        assert len(points) == 8


@pytest.mark.parametrize("names", [NAMES, ALL_ENTRIES])
@pytest.mark.parametrize("size", HARD_ERRORS)
def test_loop_agrees_with_pinocchio(names, size):
    model = loop_of(TRUTH, names=names)
    x = perturbed(model, size)
    error = model.loop(x, Q, U)
    table = model.tables(x)
    oracle = PinocchioChain(8)
    kinds = [("theta_off", "s", "a", "alpha").index(n.rsplit("_", 1)[0]) for n in names]
    rows = [int(n.rsplit("_", 1)[1]) for n in names]
    for pose, angles in enumerate(CLOSED):
        chain = (table[0] + angles, *table[1:])
        rotations, origins = oracle.frames(*chain)
        R = rotations[-1]
        columns = oracle.jacobian(*chain)
        columns[:3] = np.einsum("ij,jkl->ikl", pin.Jlog3(R) @ R.T, columns[:3])
        assert np.abs(error.residual[pose, :3] - pin.log3(R)).max() < 1e-12
        assert np.abs(error.residual[pose, 3:] - origins[-1]).max() < 1e-12
        assert np.abs(error.jac_x[pose] - columns[:, kinds, rows]).max() < 1e-12
        assert np.abs(error.jac_q[pose] - columns[:, 0, 1:]).max() < 1e-12
        assert np.abs(error.jac_u[pose] - columns[:, 0, :1]).max() < 1e-12


@pytest.mark.parametrize("tilt", [3.0, np.pi - 1e-2, np.pi - 1e-3])
def test_jacobians_near_a_half_turn_agree_with_central_differences(tilt):
    # A twist of the last link turns the tool almost over: the far end of both rotation charts.
    model = loop_of(TRUTH)
    x = TRUTH.values(NAMES)
    x[NAMES.index("alpha_7")] += tilt
    for error in (lambda y: model.loop(y, Q, U), lambda y: model.reduced(y, Q)):
        expected = central(lambda y, e=error: e(y).residual, x, 1e-7)
        assert np.abs(expected - error(x).jac_x).max() < 1e-4
    tilts = np.linalg.norm(model.reduced(x, Q).residual[:, :2], axis=1)
    assert tilts == pytest.approx(tilt, abs=1e-9)


def test_reduced_closure_is_equations_10_to_13():
    model = loop_of(TRUTH)
    x = perturbed(model, 1e-3)
    reduced, hinge = model.reduced(x, Q), model.initial_unsensed(x, Q)
    table = model.tables(x)
    oracle = PinocchioChain(8)
    for pose in range(len(Q)):
        angles = np.concatenate(([0.0], Q[pose]))
        R_c, p_c = (v[-1] for v in oracle.frames(table[0] + angles, *table[1:]))
        turn = np.arctan2(R_c[1, 0], R_c[0, 0])
        R_z = pin.utils.rotate("z", -turn)
        R, p = R_z @ R_c, R_z @ p_c
        assert np.abs(reduced.residual[pose, 2:] - p).max() < 1e-13
        # eq. 12 is the swing to first order
        assert reduced.residual[pose, 0] == pytest.approx(-R[1, 2], abs=1e-7)
        assert reduced.residual[pose, 1] == pytest.approx(R[0, 2], abs=1e-7)
        assert hinge[pose, 0] == pytest.approx(-turn, abs=1e-13)


def test_reversed_hinge_is_flagged_and_not_closed():
    model = loop_of(TRUTH)
    x = TRUTH.values(NAMES)
    x[NAMES.index("alpha_7")] += np.pi
    reduced = model.reduced(x, Q)
    assert reduced.flipped.all()
    assert (np.linalg.norm(reduced.residual[:, :2], axis=1) > 3.0).all()
    assert not model.reduced(TRUTH.values(NAMES), Q).flipped.any()


def test_invalid_entries_are_rejected():
    with pytest.raises(ValueError, match="not a D-H entry"):
        loop_of(TRUTH, names=("gamma_1",))

"""The order in which poses were taken changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

from solver.chain.pose_order import back_to_caller, canonical_order
from solver.diagnostics.cross_validation import far_block, fold_poses
from solver.estimators.error_model import ErrorModel, stated_errors
from solver.estimators.estimate import Estimate
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import estimate_with_errors
from tests.oracles.loop_oracle import Truth
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import loop_of, paper_arm

SIMULATION = Simulation(poses=30, wrist_sd=6e-3)
Q = SIMULATION.readings(0)
NOISE = NoiseModel(joint_variance=SIMULATION.sigma() ** 2)


def errors(truth: Truth) -> ErrorModel:
    return stated_errors(paper_arm(truth), samples=np.ones(len(Q), dtype=np.int64))


def same(one: Estimate, other: Estimate, shuffle: np.ndarray) -> None:
    assert other.x == pytest.approx(one.x, rel=1e-12)
    assert other.covariance == pytest.approx(one.covariance, rel=1e-12)
    assert other.sigmas.position_m.rms == pytest.approx(one.sigmas.position_m.rms, rel=1e-12)
    assert other.residual == pytest.approx(one.residual[shuffle], rel=1e-12)
    if one.chi2 is not None:
        assert other.chi2 == pytest.approx(one.chi2, rel=1e-12)
        assert other.pose_chi2 == pytest.approx(one.pose_chi2[shuffle], rel=1e-12)
        assert other.corrections == pytest.approx(one.corrections[shuffle], rel=1e-12)


@pytest.fixture(params=range(3))
def shuffle(request: pytest.FixtureRequest) -> np.ndarray:
    return np.random.default_rng(request.param).permutation(len(Q))


def test_paper(truth: Truth, shuffle: np.ndarray) -> None:
    model = loop_of(truth)
    same(estimate_paper(model, Q), estimate_paper(model, Q[shuffle]), shuffle)


def test_implicit(truth: Truth, shuffle: np.ndarray) -> None:
    model = loop_of(truth)
    one, other = (estimate_implicit(model, q, NOISE) for q in (Q, Q[shuffle]))
    same(one, other, shuffle)


def test_implicit_with_a_variance_of_its_own_for_every_pose(
    truth: Truth, shuffle: np.ndarray
) -> None:
    model = loop_of(truth)
    own = NOISE.joint_variance * np.linspace(0.5, 2.0, len(Q))[:, None]
    one = estimate_implicit(model, Q, NoiseModel(joint_variance=own))
    other = estimate_implicit(model, Q[shuffle], NoiseModel(joint_variance=own[shuffle]))
    same(one, other, shuffle)


def test_implicit_with_components(truth: Truth, shuffle: np.ndarray) -> None:
    model = loop_of(truth)
    one = estimate_with_errors(model, Q, errors(truth))
    other = estimate_with_errors(model, Q[shuffle], errors(truth).at_poses(shuffle))
    same(one.estimate, other.estimate, shuffle)
    assert [c.sd for c in one.components.components] == pytest.approx(
        [c.sd for c in other.components.components], rel=1e-12
    )


def test_hold_out_parts(shuffle: np.ndarray) -> None:
    for one, other in zip(fold_poses(Q, 5), fold_poses(Q[shuffle], 5), strict=True):
        assert set(shuffle[other]) == set(one)
    assert set(shuffle[far_block(Q[shuffle])]) == set(far_block(Q))


def test_way_there_and_back() -> None:
    order = canonical_order(Q)
    assert np.array_equal(Q[order][back_to_caller(order)], Q)
    assert np.all(np.diff(Q[order][:, 0]) >= 0.0)

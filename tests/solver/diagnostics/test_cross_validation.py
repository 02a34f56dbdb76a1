"""Hold-out and verification: the right poses, the right rates, and what they catch."""

from collections.abc import Callable

import numpy as np
import pytest

from solver.arrays import IntArray
from solver.diagnostics.cross_validation import (
    HeldOutPoses,
    far_block,
    fold_poses,
    hold_out,
    verify,
)
from solver.estimators.error_model import ErrorModel
from solver.estimators.estimate import Estimate
from solver.estimators.implicit import NoiseModel, estimate_implicit, fit_implicit
from solver.estimators.linear_fit import LinearFit
from solver.estimators.variance_components import settle
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import NAMES, loop_of

SIMULATION = Simulation(poses=50, wrist_sd=6e-3)
NOISE = NoiseModel(joint_variance=SIMULATION.sigma() ** 2)
TRAIN, TEST = slice(0, 30), slice(30, 50)


TRUTH = paper_truth()
MODEL = loop_of(TRUTH)


def implicit(q: np.ndarray, variance: np.ndarray) -> Callable[[IntArray], Estimate]:
    every = np.broadcast_to(variance, q.shape)
    return lambda rest: estimate_implicit(MODEL, q[rest], NoiseModel(joint_variance=every[rest]))


def verified(made: np.ndarray, new: np.ndarray) -> HeldOutPoses:
    """Poses `new` held against the fit of poses `made`."""
    fit = fit_implicit(MODEL, made, NOISE, TRUTH.values(NAMES))
    return verify(MODEL, fit.x, fit.covariance, new, NOISE)


@pytest.mark.campaign
def test_verification_of_sound_poses_has_the_stated_rate():
    accepted, ratios, chances = 0, [], []
    for seed in range(60):
        q = SIMULATION.rereadings(seed)
        result = verified(q[TRAIN], q[TEST])
        assert result.closed.all()
        accepted += result.chi2.low <= result.chi2.per_dof <= result.chi2.high
        ratios.append(result.chi2.per_dof)
        chances.append(result.pose_probability)
    # 99 % band: fewer than 56 of 60 inside has a chance of 3e-4.
    assert accepted >= 56
    # chi2/dof of 60 x 100: mean 1, standard error 0.018 when the parameters' share is right.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.08)
    # Probabilities of single poses are uniform: their mean over 1200 is 0.5 +- 0.008.
    assert np.mean(chances) == pytest.approx(0.5, abs=0.04)


def test_an_empty_verification_is_refused():
    with pytest.raises(ValueError, match="no poses"):
        verified(SIMULATION.rereadings(0), np.zeros((0, 7)))


def test_folds_are_disjoint_and_complete():
    q = SIMULATION.rereadings(0)
    parts = fold_poses(q[:48])
    assert sorted(np.concatenate(parts)) == list(range(48))
    assert [len(part) for part in parts] == [10, 10, 10, 9, 9]


def test_the_far_block_is_compact_and_far():
    q = SIMULATION.rereadings(0)
    block = far_block(q)
    rest = np.setdiff1d(np.arange(50), block)
    assert len(block) == 10
    scaled = q / np.ptp(q, axis=0)
    away = np.linalg.norm(scaled[block].mean(0) - scaled[rest].mean(0))
    random = np.random.default_rng(0)
    usual = [
        np.linalg.norm(scaled[pick[:10]].mean(0) - scaled[pick[10:]].mean(0))
        for pick in (random.permutation(50) for _ in range(200))
    ]
    assert away > max(usual)


def whole_fit(q: np.ndarray, variance: np.ndarray) -> tuple[LinearFit, IntArray]:
    """Fit of all poses, and the index of each of its poses."""
    errors = ErrorModel(joint_variance=np.array(np.broadcast_to(variance, q.shape)))
    fitted, order = settle(MODEL, q, errors, x0=TRUTH.values(NAMES))
    return fitted.fit, order


def test_hold_out_of_sound_poses():
    q = SIMULATION.rereadings(3)
    fit, whole = implicit(q, NOISE.joint_variance), whole_fit(q, NOISE.joint_variance)
    result = hold_out(fit, MODEL, q, *whole, fold_poses(q))
    assert [part.dof for part in result.parts] == [50] * 5
    assert result.sigmas.position_m.rms == pytest.approx(
        result.inside_sigmas.position_m.rms, rel=0.2
    )
    far = hold_out(fit, MODEL, q, *whole, (far_block(q),))
    assert far.parts[0].low <= far.parts[0].per_dof <= far.parts[0].high


def test_hold_out_uses_each_poses_own_variance():
    """Sensor noise alone: the same figure as the verification with the parameters of the other poses."""
    q = SIMULATION.rereadings(3)
    own = NOISE.joint_variance * np.linspace(0.5, 2.0, 50)[:, None]
    result = hold_out(implicit(q, own), MODEL, q, *whole_fit(q, own), (np.arange(10),))
    fit = estimate_implicit(MODEL, q[10:], NoiseModel(joint_variance=own[10:]))
    alone = verify(MODEL, fit.x, fit.covariance, q[:10], NoiseModel(joint_variance=own[:10]))
    assert result.parts[0].dof == alone.chi2.dof
    assert result.parts[0].per_dof == pytest.approx(alone.chi2.per_dof, rel=0.01)

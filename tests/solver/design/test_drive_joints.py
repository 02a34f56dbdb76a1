import numpy as np
import pytest

from solver.design.drive_joints import DriveTrial, rank_at_pose, rank_by_trial
from solver.design.motion import chain_motion
from tests.oracles.loop_oracle import closure_rates, paper_truth
from tests.solver.design.conftest import ClosedChain

TRUTH = paper_truth()


def test_leverage_vanishes_with_the_passive_singular_value(loop, x, region):
    """At a singularity of a pair both are small (oracle: complex-step Jacobian)."""
    motion = chain_motion(loop, x, region.q, region.u)
    angles = np.concatenate((region.u[:, :1], region.q), axis=1)
    J, _ = closure_rates(TRUTH, angles, ())
    passive = [0, 1, 2, 3, 4, 5]
    smallest = np.linalg.svd(J[:, :, passive], compute_uv=False)[:, -1]
    leverage = motion.leverage((6, 7))
    singular, regular = leverage < 0.02, leverage > 0.3
    assert singular.sum() > 3
    assert smallest[singular].max() < 0.3 * np.median(smallest[regular])
    assert motion.passive_conditioning((6, 7)) == pytest.approx(smallest, abs=1e-6)


def test_singular_pair_is_not_usable(loop, x, region):
    singular = int(np.argmin(region.motion.leverage((6, 7))))
    ranked = {r.drives: r for r in rank_at_pose(loop, x, region.q[singular])}
    assert not ranked[6, 7].usable
    assert "singular" in ranked[6, 7].reasons[0]


def simulate_trial(loop, x, q, drives, size=0.02) -> DriveTrial:
    """Trial of an exact arm: one drive moved at a time, the other joints by closing the loop."""
    steps = np.concatenate([(step, -step) for step in size * np.eye(len(drives))])
    start = q[[j - 1 for j in drives]]
    moved = [
        ClosedChain(loop, x, drives, q).move(dict(zip(drives, start + step, strict=True))) - q
        for step in steps
    ]
    return DriveTrial(drives=drives, commanded_rad=steps, moved_rad=np.array(moved))


def test_ranking_by_trial_agrees_with_prediction(loop, x, region):
    q = region.q[0]
    pairs = [(1, 5), (2, 5), (5, 7), (3, 6), (1, 4)]
    by_trial = rank_by_trial([simulate_trial(loop, x, q, pair) for pair in pairs])
    predicted = {r.drives: r for r in rank_at_pose(loop, x, q)}
    for trial in by_trial:
        assert trial.fastest_passive == pytest.approx(
            predicted[trial.drives].fastest_passive, rel=0.1
        )
    expected = sorted(pairs, key=lambda p: -predicted[p].score)
    assert by_trial[0].drives in expected[:2]

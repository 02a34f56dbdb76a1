"""Live estimates of any number of poses; clear paths, by a second implementation of the loop."""

from itertools import pairwise

import numpy as np
import pytest

from operator_app.config.poses_file import load_poses
from operator_app.config.procedure_file import load_procedure
from operator_app.planning.live import is_path_clear, live_quality
from solver.estimators.paper import estimate_paper
from tests.oracles.as_shipped import ARM, HINGE
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.shop_floor_chain import FOLLOW, Loop, home_hinge_angle

STEP_RAD = np.deg2rad(1.0)


def drive(loop: Loop, angles: np.ndarray, joint: int, by_deg: float) -> tuple[np.ndarray, float]:
    """True angles (8,) after a drive moved so far, and the speed of the fastest joint relative to the drive."""
    fastest = 0.0
    for _ in range(round(abs(np.deg2rad(by_deg)) / STEP_RAD)):
        ahead = angles.copy()
        ahead[joint] += np.sign(by_deg) * STEP_RAD
        (closed,), (closes,) = loop.closed(ahead[None], free=FOLLOW)
        assert closes
        fastest = max(fastest, float(np.abs(closed - angles)[1:].max() / STEP_RAD))
        angles = closed
    return angles, fastest


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("first_deg", "then_deg", "clear"), [(24.0, -10.0, True), (24.0, 12.0, False)]
)
def test_path_with_runaway_free_joints_is_not_clear(first_deg, then_deg, *, clear):
    truth, procedure = paper_truth(), load_procedure("hinge")
    model = procedure.fixture.fixture.model(procedure.arm)
    home = np.concatenate(([0.0], truth.home)) + truth.theta_off
    home[0] = home_hinge_angle(truth, home)
    loop = Loop(chain=truth)
    first, _ = drive(loop, loop.closed(home[None], free=FOLLOW)[0][0], 1, first_deg)
    second, fastest = drive(loop, first, 5, then_deg)
    assert (fastest < 1.5) if clear else (fastest > 5.0)
    first, second = first - truth.theta_off, second - truth.theta_off
    x = truth.values([p.name for p in model.parameters])
    target = {1: float(second[1]), 5: float(second[5])}
    assert is_path_clear(procedure.arm, model, x, first[1:], target) is clear
    # A target a degree beyond a joint range is not clear.
    beyond = {1: float(procedure.arm.upper_rad[0]) + 0.02, 5: float(first[5])}
    assert not is_path_clear(procedure.arm, model, x, first[1:], beyond)


@pytest.mark.campaign
def test_many_poses_are_estimated_at_growing_intervals(reference_data):
    """The cost of an estimate does not grow with the number of poses."""
    many = 150
    recorded = load_poses(reference_data / "hinge" / "hinge_quantised.csv", joint_count=7).poses
    model = HINGE.model(ARM)
    q = np.tile(recorded.q_rad, (many // len(recorded) + 1, 1))[:many]
    numbers = tuple(range(1, many + 1))
    resumed = live_quality(ARM, model, q[:125], numbers[:125])
    assert resumed.history[-1][0] == 125
    np.testing.assert_array_equal(resumed.x, estimate_paper(model, q[:125]).x)
    counts = [count for count, _ in resumed.history]
    # Each of the first hundred, then every 2 %.
    assert counts[: 101 - resumed.needed] == list(range(resumed.needed, 101))
    assert all(b <= 1.02 * a + 1.0 for a, b in pairwise(counts))
    assert len(counts) < 115
    live = resumed
    for count in range(126, many + 1):
        live = live_quality(ARM, model, q[:count], numbers[:count], earlier=live)
        assert live.numbers == numbers[:count]
        assert live.history[-1][0] >= count / 1.02 - 1.0
    assert len(live.history) - len(resumed.history) < 10
    # Coverage is of all poses, and every pose is predicted before it is used.
    np.testing.assert_allclose([low for low, _ in live.coverage], q.min(axis=0))
    assert set(live.predicted_m) >= set(range(102, many + 1))

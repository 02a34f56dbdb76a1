"""The cost of live estimates and waypoints does not grow with the number of poses."""

from itertools import pairwise

import numpy as np
import pytest

from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from operator_app.planning.exploration import Box, waypoints
from operator_app.planning.live import live_quality
from solver.estimators.paper import estimate_paper

MANY = 150


def box() -> Box:
    return Box(
        joints=(1, 5),
        centre_rad=(0.1, -0.4),
        lower_rad=(-0.5, -1.2),
        upper_rad=(0.8, 0.0),
    )


def test_waypoints_are_cached():
    cached = waypoints(box(), poses=1000, seed=3)
    assert waypoints(box(), poses=1000, seed=3) is cached
    assert waypoints(box(), poses=1000, seed=4) != cached
    assert len(cached) == 3000
    with pytest.raises(TypeError):
        cached[0][1] = 9.0  # type: ignore[index]


@pytest.mark.campaign
def test_many_poses_are_estimated_at_growing_intervals(reference_data):
    arm, fixture = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    poses = load_poses(reference_data / "hinge" / "hinge_quantised.csv", joint_count=7).poses
    model = fixture.model(arm)
    recorded = poses.q_rad
    q = np.tile(recorded, (MANY // len(recorded) + 1, 1))[:MANY]
    numbers = tuple(range(1, MANY + 1))

    resumed = live_quality(arm, model, q[:125], numbers[:125])
    assert resumed.history[-1][0] == 125
    np.testing.assert_array_equal(resumed.x, estimate_paper(model, q[:125]).x)
    counts = [count for count, _ in resumed.history]
    # Each of the first hundred, then every 2 %.
    assert counts[: 101 - resumed.needed] == list(range(resumed.needed, 101))
    assert all(b <= 1.02 * a + 1.0 for a, b in pairwise(counts))
    assert len(counts) < 115

    live = resumed
    for count in range(126, MANY + 1):
        live = live_quality(arm, model, q[:count], numbers[:count], earlier=live)
        assert live.numbers == numbers[:count]
        assert live.history[-1][0] >= count / 1.02 - 1.0
    assert len(live.history) - len(resumed.history) < 10
    # Coverage is of all poses, and every pose is predicted before it is used.
    np.testing.assert_allclose([low for low, _ in live.coverage], q.min(axis=0))
    assert set(live.predicted_m) >= set(range(102, MANY + 1))

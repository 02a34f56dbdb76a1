"""Programs killed at random instants: no accepted pose is lost or wrong, and the next command continues.

All kills, with statistics: python -m tests.benchmarks.campaign
"""

import pytest

from tests.oracles.killing import POSES, KillSequence

pytestmark = [pytest.mark.real_time, pytest.mark.campaign]


@pytest.mark.parametrize(
    ("seed", "kills", "embedded"),
    [
        pytest.param(101, 1, True, id="operator with embedded arm"),
        pytest.param(201, 8, False, id="operators and controllers on a bus"),
    ],
)
def test_killed_programs_lose_no_pose(tmp_path, seed, kills, embedded):
    statistics = KillSequence(tmp_path / "day", seed, kills, embedded=embedded).run()
    assert statistics.faults == []
    assert statistics.sessions
    assert (statistics.kills, statistics.poses) == (kills, statistics.sessions * POSES)

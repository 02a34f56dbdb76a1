"""Programs killed at random instants: nothing accepted is lost or wrong, and the next command goes on.

A share of it; all of it, with figures: python -m tests.benchmarks.campaign
"""

import pytest

from tests.oracles.killing import chain

pytestmark = pytest.mark.real_time


@pytest.mark.campaign
def test_an_operator_killed_with_its_arm_loses_nothing(tmp_path):
    found = chain(str(tmp_path / "day"), 101, 1, embedded=True)
    assert found.faults == []
    assert (found.total, found.poses) == (1, found.sessions * 6)
    assert found.sessions


@pytest.mark.campaign
@pytest.mark.timeout(900)
def test_operators_and_controllers_killed_on_a_bus_lose_nothing(tmp_path):
    found = chain(str(tmp_path / "day"), 201, 8, embedded=False)
    assert found.faults == []
    assert (found.total, found.poses) == (8, found.sessions * 6)
    assert found.sessions

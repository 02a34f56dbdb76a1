"""Programs killed at random instants: nothing accepted is lost or wrong, and the next command goes on.

A share of it; more of it: KILLS=300 pytest -m campaign tests/system/test_kills.py
"""

import os

import pytest

from tests.oracles.killing import Chain

pytestmark = pytest.mark.real_time


@pytest.mark.campaign
def test_an_operator_killed_with_its_arm_loses_nothing(tmp_path):
    found = Chain(tmp_path / "day", 101, 1, embedded=True).run()
    assert found.faults == []
    assert (found.total, found.poses) == (1, found.sessions * 6)
    assert found.sessions


@pytest.mark.campaign
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(201, 201 + int(os.environ.get("KILLS", "8")) // 8))
def test_operators_and_controllers_killed_on_a_bus_lose_nothing(tmp_path, seed):
    found = Chain(tmp_path / "day", seed, 8, embedded=False).run()
    assert found.faults == []
    assert (found.total, found.poses) == (8, found.sessions * 6)
    assert found.sessions

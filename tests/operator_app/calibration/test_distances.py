"""Distances between sockets of a real arm's ball, whose block has them 50 mm apart (tests/data/panda_ball)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fixtures.ball import Ball, KnownDistance
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.closed_loops import pick_placements
from operator_app.calibration.result import Solution
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from tests.oracles.panda import FOLDER

BLOCK_M = 0.05


def found(*measured: KnownDistance) -> Solution:
    fixture = load_fixture("ball").fixture
    assert isinstance(fixture, Ball)
    poses = load_poses(str(FOLDER / "panda_1.csv"), joint_count=7).poses
    chosen = pick_placements(poses, (3, 4))
    return calibrate(load_arm("franka_panda"), replace(fixture, distances=measured), chosen)


@pytest.fixture(scope="module")
def unmeasured() -> Solution:
    return found()


def test_the_poses_alone_find_it(unmeasured: Solution) -> None:
    (distance,) = unmeasured.distances
    assert distance.between == (3, 4)
    assert distance.measured is None
    assert abs(distance.value_m - BLOCK_M) < 3.0 * distance.sigma_m
    assert 5e-5 < distance.sigma_m < 5e-4


def test_a_measured_one_counts_like_one_observation_more(unmeasured: Solution) -> None:
    known = KnownDistance(between=(4, 3), value_m=BLOCK_M, sigma_m=1e-4)
    solution = found(known, KnownDistance(between=(1, 2), value_m=0.9, sigma_m=1e-5))
    (alone,), (distance,) = unmeasured.distances, solution.distances
    share = alone.sigma_m**2 / (alone.sigma_m**2 + known.sigma_m**2)
    # Sizes of errors are learned anew beside it: a tenth of what it moved.
    moved = BLOCK_M - alone.value_m
    assert distance.value_m - alone.value_m == pytest.approx(share * moved, abs=0.1 * abs(moved))
    assert distance.sigma_m == pytest.approx(share**0.5 * known.sigma_m, rel=0.1)
    spread = (alone.sigma_m**2 + known.sigma_m**2) ** 0.5
    assert distance.deviation == pytest.approx(moved / spread, abs=0.1)
    assert "DISTANCE" not in {n.code for n in solution.warnings}
    assert solution.components is not None
    assert solution.components.budget["distances"].max() > 0.0


def test_one_that_the_poses_contradict_is_reported() -> None:
    solution = found(KnownDistance(between=(3, 4), value_m=BLOCK_M + 2e-3, sigma_m=1e-4))
    assert "DISTANCE" in {n.code for n in solution.warnings}
    assert solution.distances[0].deviation > 4.0

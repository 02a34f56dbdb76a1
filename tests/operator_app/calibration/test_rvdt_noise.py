"""Noise of single RVDT readings, whatever was averaged, from sessions of the shop floor."""

from __future__ import annotations

from dataclasses import replace

import pytest

from operator_app.calibration.solve import Solution, calibrate
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import parse_poses
from solver.chain.poses import PoseSet
from solver.judging.rvdt import Verdict
from tests.oracles.shop_floor import Session, Sizes, session


def poses_of(taken: Session) -> PoseSet:
    return parse_poses(taken.csv().encode(), "poses.csv").poses


def solved(poses: PoseSet) -> Solution:
    return calibrate(load_arm("sarcos_dextrous"), load_fixture("hinge").fixture, poses)


@pytest.mark.parametrize(("lsb", "samples"), [(1.0, 32), (8.0, 32), (4.0, 8), (2.0, 8)])
def test_the_spread_inside_the_poses_tells_the_noise_of_a_single_reading(
    lsb: float, samples: int
) -> None:
    taken = session(7003, Sizes(noise_lsb=lsb), samples=samples)
    for verdict in solved(poses_of(taken)).rvdt:
        assert verdict.noise is not None
        assert verdict.noise.lsb == pytest.approx(lsb, rel=0.1)
        assert f"noise of a single reading {verdict.noise.lsb:.1f} LSB" in verdict.text
        # 2 LSB are allowed: the mean of 32 readings of 8 would pass, a single one must not.
        assert (verdict.verdict is Verdict.OUT_OF_SPECIFICATION) == (lsb > 2.5)


def test_single_readings_are_told_by_the_loops() -> None:
    taken = session(7003, Sizes(noise_lsb=8.0), samples=1)
    for verdict in solved(poses_of(taken)).rvdt:
        assert verdict.noise is not None
        assert verdict.noise.low <= 8.0 <= verdict.noise.high
        assert verdict.verdict is Verdict.OUT_OF_SPECIFICATION


def test_means_without_their_spread_say_that_they_cannot_tell() -> None:
    taken = session(7003, Sizes(noise_lsb=1.0), samples=32)
    for verdict in solved(replace(poses_of(taken), sd_rad=None)).rvdt:
        assert verdict.noise is not None
        assert not verdict.noise.told
        assert verdict.noise.high > 1.0
        assert "cannot be told from these poses, below" in verdict.text
        assert verdict.verdict is not Verdict.OUT_OF_SPECIFICATION

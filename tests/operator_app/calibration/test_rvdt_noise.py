"""Noise of single RVDT readings, from means, spreads and single readings."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.ball import Ball
from operator_app.calibration.calibrate import calibrate
from solver.diagnostics.rvdt import Soundness
from tests.contracts.planted import measured
from tests.oracles.as_shipped import ARM, HINGE, poses_of, solved
from tests.oracles.shop_floor import Sizes, Specimen, session
from tests.oracles.shop_floor import taken as taken_at
from tests.oracles.shop_floor_chain import frames, link_transform, rotation_about_z
from tests.oracles.shop_floor_faults import ball_instead_of_hinge


@pytest.mark.parametrize(("lsb", "samples"), [(1.0, 32), (8.0, 32), (4.0, 8), (2.0, 8)])
def test_spread_within_poses_gives_single_reading_noise(lsb, samples):
    taken = session(7003, Sizes(noise_lsb=lsb), samples=samples)
    for verdict in solved(taken).rvdt:
        assert verdict.noise.lsb == pytest.approx(lsb, rel=0.1)
        assert f"noise of a single reading {verdict.noise.lsb:.1f} LSB" in verdict.text
        # 2 LSB are allowed for a single reading; means of 32 readings of 8 LSB would pass.
        assert (verdict.verdict is Soundness.OUT_OF_SPECIFICATION) == (lsb > 2.5)


def test_noise_is_undetermined_without_spread():
    taken = session(7003, Sizes(noise_lsb=1.0), samples=32)
    for verdict in calibrate(ARM, HINGE, replace(poses_of(taken), sd_rad=None)).rvdt:
        assert not verdict.noise.determined
        assert verdict.noise.high > 1.0
        assert "not determined by these poses, below" in verdict.text
        assert verdict.verdict is not Soundness.OUT_OF_SPECIFICATION


def tool_points(taken):
    """A point on the tool in the arm's base frame (m, 3), to 20 micrometres."""
    table = ARM.table
    link = link_transform(table.s_m[6], table.a_m[6], table.alpha_rad[6])
    T = frames(taken.specimen.chain, taken.angles)
    tool = np.linalg.inv(T[:, 1]) @ T[:, 7] @ rotation_about_z(taken.angles[:, 7]) @ link
    point = (tool @ np.array([0.03, 0.02, 0.05, 1.0]))[:, :3]
    return point + 20e-6 * np.random.default_rng(1).normal(size=point.shape)


@pytest.mark.campaign
def test_measured_endpoints_give_noise_but_no_linearity():
    taken = session(7003, Sizes.only())
    at_base = {"base_m": (0.0,) * 3, "base_turn_rad": (0.0,) * 3}
    tracker = replace(measured(ARM), full_pose=False, **at_base)
    poses = replace(poses_of(taken), endpoint=tool_points(taken))
    verdicts = calibrate(ARM, tracker, poses, drop=True).rvdt
    assert [v.joint for v in verdicts] == [6, 7]
    for verdict in verdicts:
        assert verdict.noise.lsb == pytest.approx(2.0, rel=0.1)
        assert verdict.verdict is Soundness.CANNOT_DECIDE
        assert (
            "without the readings of joints 6 and 7, these poses do not determine" in verdict.text
        )
        assert "mrad" not in verdict.text


def test_several_placements_give_noise():
    poses = poses_of(session(7003, Sizes.only()))
    verdicts = calibrate(ARM, HINGE, replace(poses, placement=np.arange(len(poses)) % 2 + 1)).rvdt
    for verdict in verdicts:
        assert verdict.noise.lsb == pytest.approx(2.0, rel=0.1)
        assert "solve one placement alone" in verdict.text
    assert len(verdicts) == 2


def ball_session(seed, *, lsb, samples):
    """Poses of a tool on a ball, and the ball at its true place."""
    angles = ball_instead_of_hinge(seed).taken.angles
    specimen = Specimen.drawn(seed, Sizes(noise_lsb=lsb))
    rigid = np.zeros((len(angles), 6))
    taken = taken_at(specimen, angles, rigid, rigid, samples=samples)
    chain = specimen.chain
    tip = np.array([chain.a[7], 0.0, chain.s[7]])
    T = frames(chain, angles)
    tool = np.linalg.inv(T[:, 1]) @ T[:, 7] @ rotation_about_z(angles[:, 7])
    ground = (tool @ np.append(tip, 1.0))[:, :3]
    assert np.ptp(ground, axis=0).max() < 1e-9
    compliance = HINGE.compliance
    return taken, Ball(tip_m=tuple(tip), ground_m=tuple(ground[0]), compliance=compliance)


@pytest.mark.parametrize(("lsb", "samples"), [(1.0, 32), (2.0, 8), (8.0, 32), (2.0, 1), (8.0, 1)])
def test_ball_poses_give_noise(lsb, samples):
    taken, ball = ball_session(7003, lsb=lsb, samples=samples)
    verdicts = calibrate(ARM, ball, poses_of(taken), drop=True).rvdt
    assert [v.joint for v in verdicts] == [6, 7]
    for verdict in verdicts:
        noise = verdict.noise
        assert noise.from_spread == (samples > 1)
        if samples > 1:
            assert noise.lsb == pytest.approx(lsb, rel=0.1)
        else:
            assert noise.low <= lsb <= noise.high


@pytest.mark.campaign
def test_one_lsb_noise_is_found_from_single_readings():
    """Fixture and joints are quieter than stated."""
    noises = [
        verdict.noise
        for seed in range(7010, 7016)
        for verdict in solved(session(seed, Sizes(noise_lsb=1.0), samples=1)).rvdt
    ]
    assert all(noise is not None and not noise.from_spread for noise in noises)
    lsb = [noise.lsb for noise in noises if noise is not None]
    assert np.sqrt(np.mean(np.square(lsb))) == pytest.approx(1.0, abs=0.15)

"""Dwells of simulated recordings: each pose once with its mean, near misses reported."""

import numpy as np
import pytest

from operator_app.config.dwells import LEAST_SAMPLES, find_dwells, smallest_spread_rad
from tests.oracles.panda import panda_readings
from tests.oracles.recordings import recorded_arm


@pytest.mark.sample(5)
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate_hz", [20.0, 100.0, 1000.0])
def test_every_dwell_is_found_once_among_slow_motions(seed, rate_hz):
    _, q_rad = panda_readings()
    poses = q_rad[30 * seed : 30 * seed + 30]
    time_s, q = recorded_arm(poses, decoys=20, seed=seed, rate_hz=rate_hz)
    dwells, rejected = find_dwells(time_s, q)
    assert len(dwells) == len(poses)
    # At 20 Hz the mean of 40 samples is known to 3e-7.
    limit = 1e-6 if rate_hz > 50.0 else 1.5e-6
    assert np.abs(np.array([d.mean_rad for d in dwells]) - poses).max() < limit
    assert all(1.5 < d.seconds < 2.1 for d in dwells)
    assert min(d.samples for d in dwells) > 0.6 * 2.0 * rate_hz
    np.testing.assert_allclose(np.median([d.sd_rad for d in dwells]), 2e-6, rtol=0.2)
    assert all(r.joint for r in rejected)


def drive_joint_1(*intervals):
    """Two joints at 100 Hz; the first moves in intervals of (duration in s, speed in deg/s)."""
    speed = np.concatenate([np.full(round(100 * s), np.deg2rad(v)) for s, v in intervals])
    angle = np.cumsum(speed) * 0.01
    return np.arange(len(angle)) * 0.01, np.column_stack((angle, np.zeros(len(angle))))


def test_short_and_drifting_intervals_are_reported():
    time_s, q = drive_joint_1((1, 20), (0.7, 0), (1, 20), (3, 0.06), (1, 20), (1.5, 0), (1, 20))
    dwells, rejected = find_dwells(time_s, q)
    assert [round(d.start_s, 1) for d in dwells] == [6.7]
    (short, drifting) = rejected
    assert (short.joint, drifting.joint) == (0, 1)
    assert short.seconds == pytest.approx(0.7, abs=0.03)
    assert short.start_s == pytest.approx(1.0, abs=0.03)
    assert np.rad2deg(drifting.moved_rad) == pytest.approx(0.18, abs=0.02)


def test_drifting_interval_is_no_dwell_and_its_neighbours_are():
    time_s, q = drive_joint_1((1, 20), (2, 0), (4, 0.02), (2, 0), (1, 20))
    dwells, rejected = find_dwells(time_s, q)
    assert [round(d.start_s, 1) for d in dwells] == [1.0, 7.0]
    assert dwells[0].mean_rad[0] == pytest.approx(np.deg2rad(20.0), abs=1e-9)
    assert dwells[1].mean_rad[0] == pytest.approx(np.deg2rad(20.08), abs=1e-9)
    assert [r.joint for r in rejected] == [1]
    # Drift within the spread limit, but by most of it.
    dwells, rejected = find_dwells(*drive_joint_1((1, 20), (2, 0.02), (1, 20)))
    assert (len(dwells), [r.joint for r in rejected]) == (0, [1])


def test_gap_in_the_recording_is_no_dwell():
    time_s, q = drive_joint_1((1, 20), (0.4, 0), (60, 0), (0.3, 0), (1, 20))
    recorded = (time_s < 1.4) | (time_s > 61.4)
    dwells, rejected = find_dwells(time_s[recorded], q[recorded])
    assert not dwells
    assert [r.joint for r in rejected] == [0]
    assert find_dwells(time_s[: LEAST_SAMPLES - 1], q[: LEAST_SAMPLES - 1]) == ((), ())


def test_smallest_spread_is_that_of_the_quietest_interval():
    time_s, q = drive_joint_1((1, 20), (2, 0.1), (1, 20))
    assert np.rad2deg(smallest_spread_rad(time_s, q, 1.0)) == pytest.approx(0.1, rel=0.02)
    assert smallest_spread_rad(time_s, q, 5.0) == np.inf

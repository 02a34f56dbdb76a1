"""Dwells of simulated recordings: each pose once and right, nothing invented, what came near is named."""

import numpy as np
import pytest

from operator_app.config.dwells import LEAST_SAMPLES, find_dwells, smallest_spread_rad
from tests.oracles.panda import panda_readings
from tests.oracles.recordings import recorded_arm


@pytest.mark.sample(5)
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rate_hz", [20.0, 100.0, 1000.0])
def test_every_pose_once_and_none_of_twenty_slow_motions(seed, rate_hz):
    _, q_rad = panda_readings()
    poses = q_rad[30 * seed : 30 * seed + 30]
    time_s, q = recorded_arm(poses, decoys=20, seed=seed, rate_hz=rate_hz)
    found, refused = find_dwells(time_s, q)
    assert len(found) == len(poses)
    # At 20 Hz the mean of 40 samples is known to 3e-7.
    limit = 1e-6 if rate_hz > 50.0 else 1.5e-6
    assert np.abs(np.array([d.mean_rad for d in found]) - poses).max() < limit
    assert all(1.5 < d.seconds < 2.1 for d in found)
    assert min(d.samples for d in found) > 0.6 * 2.0 * rate_hz
    np.testing.assert_allclose(np.median([d.sd_rad for d in found]), 2e-6, rtol=0.2)
    assert all(r.joint for r in refused)


def stretches(*pieces):
    """Two joints at 100 Hz, the first of which moves for so many seconds at so many deg/s."""
    speed = np.concatenate([np.full(round(100 * s), np.deg2rad(v)) for s, v in pieces])
    first = np.cumsum(speed) * 0.01
    return np.arange(len(first)) * 0.01, np.column_stack((first, np.zeros(len(first))))


def test_short_and_moving_stretches_are_named():
    time_s, q = stretches((1, 20), (0.7, 0), (1, 20), (3, 0.06), (1, 20), (1.5, 0), (1, 20))
    found, refused = find_dwells(time_s, q)
    assert [round(d.start_s, 1) for d in found] == [6.7]
    (short, moving) = refused
    assert (short.joint, moving.joint) == (0, 1)
    assert short.seconds == pytest.approx(0.7, abs=0.03)
    assert short.start_s == pytest.approx(1.0, abs=0.03)
    assert np.rad2deg(moving.moved_rad) == pytest.approx(0.18, abs=0.02)


def test_a_creep_is_no_pose_and_costs_none_beside_it():
    time_s, q = stretches((1, 20), (2, 0), (4, 0.02), (2, 0), (1, 20))
    found, refused = find_dwells(time_s, q)
    assert [round(d.start_s, 1) for d in found] == [1.0, 7.0]
    assert found[0].mean_rad[0] == pytest.approx(np.deg2rad(20.0), abs=1e-9)
    assert found[1].mean_rad[0] == pytest.approx(np.deg2rad(20.08), abs=1e-9)
    assert [r.joint for r in refused] == [1]
    # A stretch that drifts within the spread, but by most of it.
    found, refused = find_dwells(*stretches((1, 20), (2, 0.02), (1, 20)))
    assert (len(found), [r.joint for r in refused]) == (0, [1])


def test_a_lost_minute_is_not_a_minute_at_rest():
    time_s, q = stretches((1, 20), (0.4, 0), (60, 0), (0.3, 0), (1, 20))
    seen = (time_s < 1.4) | (time_s > 61.4)
    found, refused = find_dwells(time_s[seen], q[seen])
    assert not found
    assert [r.joint for r in refused] == [0]
    assert find_dwells(time_s[: LEAST_SAMPLES - 1], q[: LEAST_SAMPLES - 1]) == ((), ())


def test_how_quiet_a_noisy_recording_is():
    time_s, q = stretches((1, 20), (2, 0.1), (1, 20))
    assert np.rad2deg(smallest_spread_rad(time_s, q, 1.0)) == pytest.approx(0.1, rel=0.02)
    assert smallest_spread_rad(time_s, q, 5.0) == np.inf

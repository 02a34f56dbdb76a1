"""Settling and capturing on a fake bus."""

import math

import numpy as np
import pytest

from tests.hardware.fake_arm import JOINTS
from tests.hardware.on_fake_bus import PER_RAD


@pytest.mark.parametrize(
    ("noisy_syncs", "settled", "syncs"), [(30, True, range(38, 42)), (1000, False, range(60, 61))]
)
def test_settle_waits_for_small_spread_until_timeout(driven, bus, noisy_syncs, settled, syncs):
    start = bus.syncs
    bus.drives[4].noise = lambda sync: 500 if sync < start + noisy_syncs and sync % 2 else 0
    spread = [100 / PER_RAD] * JOINTS
    assert driven.settle(window=10, spread_rad=spread, timeout_syncs=60) is settled
    assert bus.syncs - start in syncs


def test_reading_has_mean_sd_and_count_of_samples(driven, bus):
    noise = [3, -1, 4, 1, -5, 9, -2, 6]
    start = bus.syncs
    bus.drives[6].noise = lambda sync: noise[(sync - start - 1) % len(noise)]
    reading = driven.capture(len(noise))
    values = np.array(noise) + 6000
    assert reading.samples == len(noise)
    assert reading.mean_counts[5] == values.mean()
    assert reading.mean_rad[5] == pytest.approx(values.mean() / PER_RAD, rel=1e-14)
    variance = sum((v - values.mean()) ** 2 for v in values) / (len(noise) - 1)
    assert reading.sd_rad[5] == pytest.approx(math.sqrt(variance) / PER_RAD, rel=1e-12)
    assert reading.sd_rad[0] == 0.0
    assert reading.first_sync == driven.snapshot().sync_count - len(noise) + 1
    assert np.all(driven.capture(1).sd_rad == 0.0)


@pytest.mark.parametrize("fault", ["without_tpdo", "doubling_tpdo"])
def test_incomplete_sample_is_excluded_from_reading(driven, bus, fault):
    start = bus.syncs

    def disturb(sync: int) -> None:
        joints = getattr(bus, fault)
        joints.clear()
        if sync == start + 3:
            joints.add(2)
            bus.drives[6].counts += 1000
        elif sync == start + 4:
            bus.drives[6].counts -= 1000

    bus.on_sync = disturb
    reading = driven.capture(6)
    assert bus.syncs - start == 7
    assert reading.mean_counts[5] == 6000
    assert reading.sd_rad[5] == 0.0


def test_snapshot_ages_are_never_negative(driven, monkeypatch):
    """Frames may arrive while a snapshot is being built."""
    connection = driven._connection
    clock = connection._clock

    def clock_before_a_capture() -> float:
        now_s = clock()
        driven.capture(2)
        return now_s

    monkeypatch.setattr(connection, "_clock", clock_before_a_capture)
    assert all(joint.age_s >= 0.0 for joint in driven.snapshot().joints)

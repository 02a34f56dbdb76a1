"""Settling and capturing on a fake bus: whole samples and no others."""

import math

import numpy as np
import pytest

from tests.hardware.fake_arm import JOINTS
from tests.hardware.on_fake_bus import PER_RAD


def test_settling_waits_for_the_spread_to_shrink(driven, bus):
    start = bus.syncs
    bus.drives[4].noise = lambda sync: 500 if sync < start + 30 and sync % 2 else 0
    spread = [100 / PER_RAD] * JOINTS
    assert driven.settle(window=10, spread_rad=spread, timeout_syncs=200)
    assert 38 <= bus.syncs - start <= 41


def test_settling_gives_up_after_its_syncs(driven, bus):
    start = bus.syncs
    bus.drives[4].noise = lambda sync: 500 * (sync % 2)
    spread = [100 / PER_RAD] * JOINTS
    assert not driven.settle(window=10, spread_rad=spread, timeout_syncs=60)
    assert bus.syncs - start == 60


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


def test_one_sample_has_no_deviation(driven):
    assert np.all(driven.capture(1).sd_rad == 0.0)


@pytest.mark.parametrize("fault", ["silent", "twice"])
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
    """Frames may come in between the parts that it is made of."""
    connection = driven._connection
    real = connection._clock

    def late() -> float:
        now_s = real()
        driven.capture(2)
        return now_s

    monkeypatch.setattr(connection, "_clock", late)
    assert all(joint.age_s >= 0.0 for joint in driven.snapshot().joints)

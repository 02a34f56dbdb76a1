import math
from dataclasses import replace

import pytest

from hardware.canopen.objects import SensorKind
from hardware.virtual.axis import AxisSettings, arm_axes, joint_scale
from solver.chain.sensors import Encoder, NoSensor, Rvdt
from tests.oracles.virtual_rig import joint


def test_an_encoder_axis():
    made = AxisSettings(3, joint())
    assert made.joint == 3
    assert (made.sensor_kind, made.converter_bits) == (SensorKind.ENCODER, 0)
    assert (made.increments, made.revolutions) == (36_000, 1)
    assert (made.limits.lower_counts, made.limits.upper_counts) == (-6000, 6000)
    assert made.max_speed_counts_per_s == 18_000
    assert made.limits.max_step_counts == 181
    assert made.following_window_counts == 300
    assert (made.lowest_counts, made.highest_counts) == (-math.inf, math.inf)


def test_an_rvdt_axis():
    made = AxisSettings(6, joint(rvdt=True))
    assert (made.sensor_kind, made.converter_bits) == (SensorKind.RVDT, 12)
    assert made.full_scale_microdeg == 144_000_000
    assert (made.increments, made.revolutions) == (10_240, 1)
    assert (made.lowest_counts, made.highest_counts) == (-2048, 2047)
    assert joint_scale(joint(rvdt=True)).to_counts(math.radians(144.0)) == 4096


def test_a_full_scale_that_does_not_divide_a_turn():
    sensor = Rvdt(bits=12, full_scale_rad=math.radians(110.25), linearity=0.0, noise_lsb=0.0)
    made = AxisSettings(6, replace(joint(), sensor=sensor))
    per_rad = made.increments / made.revolutions / math.tau
    assert per_rad == pytest.approx(made.scale.counts_per_rad, rel=1e-12)


def test_a_joint_without_a_sensor_has_no_drive():
    with pytest.raises(ValueError, match="no sensor"):
        AxisSettings(1, replace(joint(), sensor=NoSensor()))


def test_axes_of_an_arm_are_numbered_from_one(sarcos):  # type: ignore[no-untyped-def]
    made = arm_axes(sarcos)
    assert [a.joint for a in made] == [1, 2, 3, 4, 5, 6, 7]
    for settings, j in zip(made, sarcos.joints, strict=True):
        kind = SensorKind.ENCODER if isinstance(j.sensor, Encoder) else SensorKind.RVDT
        assert settings.sensor_kind is kind
        assert settings.scale.to_rad(1) == pytest.approx(j.sensor.resolution_rad, rel=1e-15)

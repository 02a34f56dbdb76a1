import math
from dataclasses import replace

import pytest

from hardware.canopen.objects import SensorKind
from hardware.virtual.axis import AxisSettings, arm_axes, joint_scale
from solver.chain.sensors import Encoder, NoSensor, Rvdt
from tests.hardware.virtual.conftest import SARCOS
from tests.oracles.virtual_rig import joint


def test_limits_and_windows_are_in_counts():
    encoder, rvdt = AxisSettings(3, joint()), AxisSettings(6, joint(rvdt=True))
    assert encoder.limits.max_step_counts == 181
    assert encoder.following_window_counts == 300
    assert (encoder.lowest_counts, encoder.highest_counts) == (-math.inf, math.inf)
    assert (rvdt.lowest_counts, rvdt.highest_counts) == (-2048, 2047)
    assert (rvdt.increments, rvdt.revolutions) == (10_240, 1)
    assert joint_scale(joint(rvdt=True)).to_counts(math.radians(144.0)) == 4096


def test_gear_ratio_of_a_full_scale_that_does_not_divide_a_turn():
    sensor = Rvdt(bits=12, full_scale_rad=math.radians(110.25), linearity=0.0, noise_lsb=0.0)
    axis = AxisSettings(6, replace(joint(), sensor=sensor))
    per_rad = axis.increments / axis.revolutions / math.tau
    assert per_rad == pytest.approx(axis.scale.counts_per_rad, rel=1e-12)


def test_joint_without_sensor_is_refused():
    with pytest.raises(ValueError, match="no sensor"):
        AxisSettings(1, replace(joint(), sensor=NoSensor()))


def test_axes_of_an_arm_have_its_joint_numbers_and_sensors():
    axes = arm_axes(SARCOS)
    assert [axis.joint for axis in axes] == [1, 2, 3, 4, 5, 6, 7]
    for axis, joint_ in zip(axes, SARCOS.joints, strict=True):
        kind = SensorKind.ENCODER if isinstance(joint_.sensor, Encoder) else SensorKind.RVDT
        assert axis.sensor_kind is kind
        assert axis.scale.to_rad(1) == pytest.approx(joint_.sensor.resolution_rad, rel=1e-15)

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import legendre

from hardware.virtual.axis import AxisSettings, LinearityDeviation, joint_sensor
from solver.chain.sensors import NoSensor, Rvdt
from tests.hardware.virtual.conftest import SARCOS
from tests.oracles.virtual_rig import joint

FULL_SCALE_RAD = math.radians(120.0)


def test_limits_and_windows_are_in_counts():
    encoder, rvdt = AxisSettings(3, joint()), AxisSettings(6, joint(rvdt=True))
    assert encoder.limits.max_step_counts == 181
    assert encoder.following_window_counts == 300
    assert (encoder.lowest_counts, encoder.highest_counts) == (-math.inf, math.inf)
    assert (rvdt.lowest_counts, rvdt.highest_counts) == (-2048, 2047)
    assert (rvdt.increments, rvdt.revolutions) == (10_240, 1)
    assert rvdt.scale.to_counts(math.radians(144.0)) == 4096


def test_gear_ratio_of_a_full_scale_that_does_not_divide_a_turn():
    sensor = Rvdt(bits=12, full_scale_rad=math.radians(110.25), linearity=0.0, noise_lsb=0.0)
    axis = AxisSettings(6, replace(joint(), sensor=sensor))
    per_rad = axis.increments / axis.revolutions / math.tau
    assert per_rad == pytest.approx(axis.scale.counts_per_rad, rel=1e-12)


def test_joint_without_a_node_number_is_refused():
    """Node 16 is the supervisor."""
    assert AxisSettings(15, joint()).joint == 15
    with pytest.raises(ValueError, match=r"joint 16 is not one of 1\.\.15"):
        AxisSettings(16, joint())


def draw_curve(seed: int, peak: float = 0.02) -> LinearityDeviation:
    return LinearityDeviation.drawn(
        np.random.default_rng(seed), full_scale_rad=FULL_SCALE_RAD, peak=peak
    )


@pytest.mark.parametrize("number", [1, 5, 6, 7])
def test_counts_are_rounded_to_the_resolution(number):
    description = SARCOS.joints[number - 1]
    sensor = joint_sensor(description, with_noise=False, curve=None)
    lsb = 2.0 * math.pi / 400_000 if number <= 5 else math.radians(120.0) / 4096
    rng = np.random.default_rng(0)
    inside = rng.uniform(description.lower_rad + lsb, description.upper_rad - lsb, 500)
    for angle in inside.tolist():
        count = sensor.counts(angle, 0.0)
        assert isinstance(count, int)
        assert abs(count * lsb - angle) <= 0.5 * lsb * (1.0 + 1e-9)
        assert sensor.counts(count * lsb, 0.0) == count
    if number <= 5:
        assert sensor.counts(20.0 * math.pi, 0.0) == 4_000_000, "an encoder does not saturate"


@pytest.mark.parametrize("number", [6, 7])
def test_rvdt_saturates_at_4096_codes_about_the_middle_of_the_range(number):
    description = SARCOS.joints[number - 1]
    sensor = joint_sensor(description, with_noise=False, curve=None)
    lsb = math.radians(120.0) / 4096
    below = sensor.counts(description.lower_rad - 1.0, 0.0)
    above = sensor.counts(description.upper_rad + 1.0, 0.0)
    assert above - below == 4095
    assert below * lsb == pytest.approx(description.lower_rad, abs=0.51 * lsb)
    assert sensor.counts(description.middle_rad, 0.0) == below + 2048
    noisy = joint_sensor(description, with_noise=True, curve=None)
    assert noisy.counts(description.upper_rad - 2.5 * lsb, 100.0) == above


@pytest.mark.parametrize("seed", range(12))
def test_linearity_deviation_reaches_its_peak_and_has_no_line(seed):
    curve = draw_curve(seed)
    angles = np.linspace(-0.5, 0.5, 20_001) * FULL_SCALE_RAD
    deviation = np.array([curve.deviation_rad(a) for a in angles.tolist()])
    largest = np.abs(deviation).max() / FULL_SCALE_RAD
    assert 0.0199999 < largest <= 0.02 * (1.0 + 1e-12)
    slope, offset = np.polyfit(angles, deviation, 1)
    # The rest is the trapezoid error of the even grid, not a line in the curve.
    assert abs(slope) < 1e-4
    assert abs(offset) < 1e-5


def test_linearity_deviation_is_its_legendre_series():
    curve = LinearityDeviation(coefficients_rad=(0.3, -0.2, 0.1, 0.05), half_scale_rad=2.0)
    for angle in (-2.0, -1.1, 0.0, 0.3, 2.0):
        series = np.array([0.0, 0.0, 0.3, -0.2, 0.1, 0.05])
        assert curve.deviation_rad(angle) == pytest.approx(
            float(legendre.legval(angle / 2.0, series)), abs=1e-14
        )
    assert curve.deviation_rad(5.0) == curve.deviation_rad(2.0)


def test_linearity_deviation_shifts_the_reading():
    curve, wrist = draw_curve(5), SARCOS.joints[5]
    sensor = joint_sensor(wrist, with_noise=False, curve=curve)
    for part in (-0.4, -0.1, 0.2, 0.45):
        angle = wrist.middle_rad + part * FULL_SCALE_RAD
        reading = sensor.counts(angle, 0.0) * sensor.resolution_rad
        assert reading - angle == pytest.approx(
            curve.deviation_rad(part * FULL_SCALE_RAD), abs=0.51 * sensor.resolution_rad
        )


def test_noise_has_its_stated_sigma_and_is_reproducible():
    wrist = [joint_sensor(j, with_noise=True, curve=None) for j in SARCOS.joints[5:]]
    middle = [j.middle_rad for j in SARCOS.joints[5:]]

    def readings(seed: int) -> np.ndarray:
        draws = np.random.default_rng(seed).standard_normal((4000, len(wrist))).tolist()
        return np.array(
            [
                [s.counts(*read) for s, *read in zip(wrist, middle, row, strict=True)]
                for row in draws
            ]
        )

    first = readings(7)
    # 2 LSB and the rounding of the converter; its standard uncertainty from 4,000 draws is 1.2 %.
    assert first.std(axis=0) == pytest.approx([math.hypot(2.0, 12**-0.5)] * 2, rel=0.06)
    np.testing.assert_array_equal(first, readings(7))
    assert not np.array_equal(first, readings(8))


def test_missing_sensor_is_refused():
    with pytest.raises(ValueError, match="no sensor"):
        AxisSettings(1, replace(joint(), sensor=NoSensor()))
    with pytest.raises(ValueError, match="no sensor"):
        joint_sensor(replace(SARCOS.joints[0], sensor=NoSensor()), with_noise=False, curve=None)

"""Errors that files state: tolerances, sensor errors, compliance, masses; overridden by row, assumed if absent."""

import math
import re

import numpy as np
import pytest

from fixtures.base import RIGID, Compliance
from operator_app.config.any_file import json_schema
from operator_app.config.arm_file import load_arm, parse_arm
from operator_app.config.fixture_file import parse_fixture
from operator_app.config.resources import resolve
from solver.chain.kinematics import forward
from solver.chain.sensors import Encoder
from solver.chain.statics import torque_rates
from tests.contracts.planted import FIXTURES

SARCOS = resolve("arm", "sarcos_dextrous").data.decode()
ERROR_KEYS = re.compile(
    r"^tolerance: .*\n|^    (?:backlash|sag)_deg: .*\n|, accuracy_deg: 0.01|, gain: 0.005",
    re.MULTILINE,
)
ARM_WITHOUT_ERRORS = ERROR_KEYS.sub("", SARCOS)


def parse_sarcos(text):
    return parse_arm(text.encode(), "a.yaml")


def test_missing_arm_errors_are_assumed_and_listed():
    arm = parse_sarcos(ARM_WITHOUT_ERRORS)
    stated = load_arm("sarcos_dextrous")
    assert stated.assumed == ()
    hundredth_rad = math.radians(0.01)
    np.testing.assert_array_equal(stated.accuracy_rad, [hundredth_rad] * 5 + [0.0] * 2)
    np.testing.assert_array_equal(stated.backlash_rad, hundredth_rad)
    np.testing.assert_array_equal(stated.sag_rad, hundredth_rad)
    np.testing.assert_array_equal(arm.length_tolerance_m, stated.length_tolerance_m)
    np.testing.assert_array_equal(arm.twist_tolerance_rad, stated.twist_tolerance_rad)
    assert arm.joints == stated.joints
    assert arm.assumed == (
        "tolerance.length_mm: 0.5",
        "tolerance.twist_deg: 0.1",
        "accuracy_deg: 0.01 (joints 1, 2, 3, 4, 5)",
        "gain: 0.005 (joints 6, 7)",
        "backlash_deg: 0.01 (joints 1, 2, 3, 4, 5, 6, 7)",
        "sag_deg: 0.01 (joints 1, 2, 3, 4, 5, 6, 7)",
    )


def test_error_that_no_joint_or_row_uses_is_not_assumed():
    """Here one joint has no sensor, the others state all errors, and every row states its length."""
    text = SARCOS.replace("tolerance: {length_mm: 0.5, twist_deg: 0.1}\n", "", 1)
    text = re.sub(r"(  - \{row: .*)\}", r"\1, tolerance: {length_mm: 0.05}}", text)
    sensor = "sensor: {kind: rvdt, bits: 12, full_scale_deg: 120, linearity: 0.02, noise_lsb: 2, gain: 0.005}"
    assert sensor in text
    text = text.replace(sensor, "sensor: {kind: none}", 1).replace("theta_off_6, ", "", 1)
    head, separator, tail = text.partition("name: wrist 1")
    tail = tail.replace("    backlash_deg: 0.01\n    sag_deg: 0.01\n", "", 1)
    assert parse_sarcos(head + separator + tail).assumed == ("tolerance.twist_deg: 0.1",)


def test_row_tolerance_overrides_the_arm_tolerance():
    row = "{row: 3, theta_off_deg: -20,  s_m: 0.355,   a_m: 0,       alpha_deg: 90"
    assert row in SARCOS
    arm = parse_sarcos(SARCOS.replace(row, f"{row}, tolerance: {{length_mm: 0.02}}"))
    np.testing.assert_allclose(arm.length_tolerance_m[2], 2e-5, rtol=1e-14)
    np.testing.assert_allclose(np.delete(arm.length_tolerance_m, 2), 5e-4, rtol=1e-14)
    np.testing.assert_allclose(arm.twist_tolerance_rad, math.radians(0.1), rtol=1e-14)
    exact = parse_sarcos(SARCOS.replace(row, f"{row}, tolerance: 0"))
    assert (exact.length_tolerance_m[2], exact.twist_tolerance_rad[2]) == (0.0, 0.0)
    assert np.all(np.delete(exact.length_tolerance_m, 2) > 0.0)


@pytest.mark.parametrize("zero", ["0", "0.0", "{length_mm: 0, twist_deg: 0}"])
def test_zero_tolerance_is_exact_and_not_assumed(zero):
    arm = parse_sarcos(ARM_WITHOUT_ERRORS.replace("joints:\n", f"tolerance: {zero}\njoints:\n", 1))
    assert not np.any(arm.length_tolerance_m)
    assert not np.any(arm.twist_tolerance_rad)
    assert not [line for line in arm.assumed if line.startswith("tolerance")]


def test_encoder_and_fixture_built_in_code_are_exact():
    assert Encoder(counts_per_rev=4096).accuracy_rad == 0.0
    for kind in FIXTURES.values():
        assert kind(load_arm("sarcos_dextrous")).compliance == RIGID


def test_gain_of_an_rvdt_may_be_exact():
    exact = parse_sarcos(SARCOS.replace("gain: 0.005", "gain: 0"))
    assert [joint.sensor.gain for joint in exact.joints[5:]] == [0.0, 0.0]


def parse_hinge_with(line):
    hinge = resolve("fixture", "hinge").data.decode()
    text = re.sub(r"^give: .*\n", "", hinge, flags=re.MULTILINE) + line
    return parse_fixture(text.encode(), "f.yaml").fixture


def test_missing_compliance_is_assumed_and_listed():
    lines = ("give.position_mm: 0.2", "give.orientation_mrad: 0.2")
    both = Compliance(position_m=0.2 / 1e3, orientation_rad=0.2 / 1e3, assumed=lines)
    assert parse_hinge_with("").compliance == both
    one = parse_hinge_with("give: {position_mm: 1}\n").compliance
    assert (one.position_m, one.assumed) == (0.001, lines[1:])
    assert parse_hinge_with("give: 0\n").compliance == RIGID


NO_MASSES = re.sub(r"^(?:gravity: |links:|  - \{link: ).*\n", "", SARCOS, flags=re.MULTILINE)


def test_gravity_loads_panda_joints_2_and_4_and_masses_are_optional():
    """Torques with the arm horizontal, then vertical; the maker states 3 kg of payload at 87 N m."""
    arm = load_arm("franka_panda")
    table = arm.table
    theta = table.theta_off_rad + np.deg2rad([[0, 90, 0, 0, 0, 90, 0], [30, 0, 0, -4, 0, 0, 0]])
    frames = forward(theta, table.s_m, table.a_m, table.alpha_rad)
    rates = torque_rates(frames, arm.masses.down)
    stretched, vertical = np.einsum("...jka,ka->...j", rates, arm.masses.moments)
    np.testing.assert_allclose([stretched[0], vertical[0]], 0.0, atol=1e-12)
    assert 40.0 < stretched[1] < 60.0
    assert -25.0 < stretched[3] < -10.0
    assert np.abs(vertical).max() < 6.0
    assert np.abs(stretched[[4, 6]]).max() < 1.0
    without_masses = parse_sarcos(NO_MASSES)
    assert (without_masses.masses, without_masses.assumed) == (None, ())


@pytest.mark.parametrize("length", [1e-300, 1.0, 1e300])
def test_link_tolerances_override_and_gravity_has_any_length(length):
    text = SARCOS.replace(
        "{link: 3, mass_kg: 4.0, centre_m: [0, 0, 0.18]}",
        "{link: 3, mass_kg: 4.0, centre_m: [0, 0, 0.18], mass_tolerance_percent: 5, "
        "centre_tolerance_mm: 2}",
    ).replace("down: [-1, 0, 0], tolerance_deg: 3", f"down: [0, {3 * length}, {-4 * length}]")
    masses = parse_sarcos(text).masses
    assert masses.mass_sd_kg[2] == pytest.approx(0.2)
    assert masses.centre_sd_m[2] == pytest.approx(0.002)
    others = [0, 1, 3, 4, 5, 6]
    np.testing.assert_allclose(masses.mass_sd_kg[others], 0.2 * masses.mass_kg[others])
    np.testing.assert_allclose(masses.centre_sd_m[others], 0.015)
    np.testing.assert_allclose(masses.centre_m[2], [0.0, 0.0, 0.18])
    np.testing.assert_allclose(masses.down, [0.0, 0.6, -0.8])
    assert masses.down_sd_rad == pytest.approx(np.deg2rad(3.0))


def test_json_schema_states_the_frame_of_a_centre_and_the_required_keys():
    link = json_schema("arm")["$defs"]["LinkModel"]
    assert "origin of frame j-1" in link["properties"]["centre_m"]["description"]
    assert set(link["required"]) == {"link", "mass_kg", "centre_m"}

"""What files state about what is not known exactly: read, overridden by row, assumed where absent."""

import math
import re
from importlib.resources import files

import numpy as np
import pytest

from fixtures.base import RIGID, Compliance
from operator_app.config.any_file import json_schema
from operator_app.config.arm_file import load_arm, parse_arm
from operator_app.config.errors import ConfigError
from operator_app.config.fixture_file import load_fixture, parse_fixture
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import forward
from solver.chain.sensors import Encoder, Rvdt
from solver.chain.statics import torque_rates
from tests.contracts.planted import FIXTURES
from tests.oracles.mistakes import one_mistake

SARCOS = (files("operator_app") / "data" / "arms" / "sarcos_dextrous.yaml").read_text("utf-8")
HINGE = (files("fixtures") / "data" / "hinge.yaml").read_text("utf-8")
STATED = re.compile(
    r"^tolerance: .*\n|^    (?:backlash|sag)_deg: .*\n|, accuracy_deg: 0.01|, gain: 0.005",
    re.MULTILINE,
)
OLD_ARM = STATED.sub("", SARCOS)
"""As arm files were before there was an error model."""
OLD_HINGE = re.sub(r"^give: .*\n", "", HINGE, flags=re.MULTILINE)


def arm_of(text):
    return parse_arm(text.encode(), "a.yaml")


@pytest.mark.parametrize(
    ("name", "length_mm", "twist_deg", "sag_deg"),
    [("sarcos_dextrous", 0.5, 0.1, 0.01), ("franka_panda", 1.0, 0.2, 0.03)],
)
def test_packaged_arms_state_everything(name, length_mm, twist_deg, sag_deg):
    arm = load_arm(name)
    assert arm.assumed == ()
    np.testing.assert_allclose(arm.length_tolerance_m, length_mm / 1e3, rtol=1e-14)
    np.testing.assert_allclose(arm.twist_tolerance_rad, math.radians(twist_deg), rtol=1e-14)
    for k, joint in enumerate(arm.joints):
        accuracy = math.radians(0.01) if isinstance(joint.sensor, Encoder) else 0.0
        assert arm.accuracy_rad[k] == accuracy
    np.testing.assert_array_equal(arm.backlash_rad, math.radians(0.01))
    np.testing.assert_array_equal(arm.sag_rad, math.radians(sag_deg))
    assert arm.masses is not None


def test_a_file_without_figures_is_read_with_the_assumed_ones_and_says_so():
    arm = arm_of(OLD_ARM)
    stated = load_arm("sarcos_dextrous")
    assert arm.tolerances == stated.tolerances
    assert arm.joints == stated.joints
    assert arm.assumed == (
        "tolerance.length_mm: 0.5",
        "tolerance.twist_deg: 0.1",
        "accuracy_deg: 0.01 (joints 1, 2, 3, 4, 5)",
        "gain: 0.005 (joints 6, 7)",
        "backlash_deg: 0.01 (joints 1, 2, 3, 4, 5, 6, 7)",
        "sag_deg: 0.01 (joints 1, 2, 3, 4, 5, 6, 7)",
    )


def test_what_no_joint_or_row_takes_is_not_assumed():
    """One joint without a sensor, all others stated; every row states its own length."""
    text = SARCOS.replace("tolerance: {length_mm: 0.5, twist_deg: 0.1}\n", "", 1)
    text = re.sub(r"(  - \{row: .*)\}", r"\1, tolerance: {length_mm: 0.05}}", text)
    sensor = "sensor: {kind: rvdt, bits: 12, full_scale_deg: 120, linearity: 0.02, noise_lsb: 2, gain: 0.005}"
    assert sensor in text
    text = text.replace(sensor, "sensor: {kind: none}", 1).replace("theta_off_6, ", "", 1)
    head, sep, tail = text.partition("name: wrist 1")
    tail = tail.replace("    backlash_deg: 0.01\n    sag_deg: 0.01\n", "", 1)
    assert arm_of(head + sep + tail).assumed == ("tolerance.twist_deg: 0.1",)


def test_one_row_may_differ_and_takes_the_rest_from_the_arm():
    row = "{row: 3, theta_off_deg: -20,  s_m: 0.355,   a_m: 0,       alpha_deg: 90"
    assert row in SARCOS
    arm = arm_of(SARCOS.replace(row, f"{row}, tolerance: {{length_mm: 0.02}}"))
    np.testing.assert_allclose(arm.length_tolerance_m[2], 2e-5, rtol=1e-14)
    np.testing.assert_allclose(np.delete(arm.length_tolerance_m, 2), 5e-4, rtol=1e-14)
    np.testing.assert_allclose(arm.twist_tolerance_rad, math.radians(0.1), rtol=1e-14)
    exact = arm_of(SARCOS.replace(row, f"{row}, tolerance: 0"))
    assert (exact.length_tolerance_m[2], exact.twist_tolerance_rad[2]) == (0.0, 0.0)
    assert np.all(np.delete(exact.length_tolerance_m, 2) > 0.0)


@pytest.mark.parametrize("zero", ["0", "0.0", "{length_mm: 0, twist_deg: 0}"])
def test_zero_is_exact_and_is_stated(zero):
    arm = arm_of(OLD_ARM.replace("joints:\n", f"tolerance: {zero}\njoints:\n", 1))
    assert not np.any(arm.length_tolerance_m)
    assert not np.any(arm.twist_tolerance_rad)
    assert not [line for line in arm.assumed if line.startswith("tolerance")]


def test_an_arm_made_in_a_program_is_exact():
    known = load_arm("sarcos_dextrous")
    arm = ArmModel(
        name="a", table=known.table, joints=known.joints, free=(), home_rad=known.home_rad
    )
    assert not np.any(arm.length_tolerance_m)
    assert not np.any(arm.twist_tolerance_rad)
    assert arm.length_tolerance_m.shape == (7,)
    assert Encoder(counts_per_rev=4096).accuracy_rad == 0.0
    for kind in FIXTURES.values():
        assert kind(known).compliance == RIGID
    with pytest.raises(ValueError, match="one tolerance per D-H row"):
        ArmModel(
            name="a",
            table=known.table,
            joints=known.joints,
            free=(),
            home_rad=known.home_rad,
            tolerances=known.tolerances[:3],
        )


def test_rvdts_have_their_own_figure():
    problem = one_mistake(arm_of, SARCOS, "noise_lsb: 2,", "noise_lsb: 2, accuracy_deg: 0.01,")
    assert "joints[joint 6].sensor.accuracy_deg: unknown key" in str(problem)
    for joint in load_arm("sarcos_dextrous").joints[5:]:
        assert isinstance(joint.sensor, Rvdt)
        assert joint.sensor.gain == 0.005
    (exact,) = {j.sensor.gain for j in arm_of(SARCOS.replace("gain: 0.005", "gain: 0")).joints[5:]}
    assert exact == 0.0


BAD = [
    ("{length_mm: 0.5,", "{length_mm: -0.5,"),
    ("{length_mm: 0.5,", "{length_mm: 60,"),
    ("twist_deg: 0.1}", "twist_deg: 12}"),
    ("twist_deg: 0.1}", "twist_deg: .nan}"),
    ("{length_mm: 0.5,", "{length_m: 0.0005,"),
    ("tolerance: {length_mm: 0.5, twist_deg: 0.1}", "tolerance: 1"),
    ("tolerance: {length_mm: 0.5, twist_deg: 0.1}", "tolerance: false"),
    ("accuracy_deg: 0.01", "accuracy_deg: 11"),
    ("gain: 0.005", "gain: 0.6"),
    ("gain: 0.005", "gain: -0.1"),
    ("backlash_deg: 0.01", "backlash_deg: -1"),
    ("sag_deg: 0.01", "sag_deg: much"),
]


@pytest.mark.parametrize(("old", "new"), BAD)
def test_figures_that_cannot_be_are_refused(old, new, approve):
    approve(str(one_mistake(arm_of, SARCOS, old, new)))


@pytest.mark.parametrize("name", ["hinge", "rigid", "ball"])
def test_packaged_fixtures_state_how_far_they_give(name):
    give = load_fixture(name).fixture.compliance
    assert give.position_m == pytest.approx(2e-4, rel=1e-14)
    assert give.orientation_rad == pytest.approx(2e-4, rel=1e-14)
    assert give.assumed == ()


def test_a_fixture_without_give_is_read_with_the_assumed_one_and_says_so():
    give = parse_fixture(OLD_HINGE.encode(), "f.yaml").fixture.compliance
    lines = ("give.position_mm: 0.2", "give.orientation_mrad: 0.2")
    assert give == Compliance(position_m=0.2 / 1e3, orientation_rad=0.2 / 1e3, assumed=lines)
    part = parse_fixture(
        (OLD_HINGE + "give: {position_mm: 1}\n").encode(), "f.yaml"
    ).fixture.compliance
    assert (part.position_m, part.assumed) == (0.001, lines[1:])
    rigid = parse_fixture((OLD_HINGE + "give: 0\n").encode(), "f.yaml").fixture.compliance
    assert rigid == RIGID


@pytest.mark.parametrize(
    ("give", "says"),
    [
        ("{position_mm: 51}", "give.position_mm: 51 mm is too large for an uncertainty"),
        ("{position_mm: -1}", "give.position_mm: must be at least 0, not -1"),
        ("{orientation_mrad: 300}", "give.orientation_mrad: 300 mrad is too large for"),
        ("{orientation_deg: 1}", "this file uses milliradians, not degrees"),
    ],
)
def test_a_give_that_cannot_be_is_refused(give, says):
    with pytest.raises(ConfigError, match=re.escape(says)):
        parse_fixture((OLD_HINGE + f"give: {give}\n").encode(), "f.yaml")


WEIGHTLESS = re.sub(r"^(?:gravity: |links:|  - \{link: ).*\n", "", SARCOS, flags=re.MULTILINE)


def test_the_packaged_arm_weighs_something():
    masses = load_arm("sarcos_dextrous").masses
    assert masses.mass_kg.shape == (7,)
    np.testing.assert_allclose(masses.mass_sd_kg, 0.2 * masses.mass_kg)
    np.testing.assert_allclose(masses.centre_sd_m, 0.015)
    # As the virtual arm hangs: its first axis is level.
    np.testing.assert_array_equal(masses.down, [-1.0, 0.0, 0.0])
    assert masses.down_sd_rad == pytest.approx(np.deg2rad(3.0))
    # The centre of the upper arm lies on its own axis, half way to the elbow.
    np.testing.assert_allclose(masses.centre_m[2], [0.0, 0.0, 0.18])


def test_the_panda_hangs_on_its_second_and_fourth_joint():
    """Torques of the identified masses, stretched out: the maker states a payload of 3 kg at 87 N m."""
    arm = load_arm("franka_panda")
    assert arm.masses is not None
    table = arm.table
    theta = table.theta_off_rad + np.deg2rad([[0, 90, 0, 0, 0, 90, 0], [30, 0, 0, -4, 0, 0, 0]])
    frames = forward(theta, table.s_m, table.a_m, table.alpha_rad)
    rates = torque_rates(frames, arm.masses.down)
    stretched, upright = np.einsum("...jka,ka->...j", rates, arm.masses.moments)
    np.testing.assert_allclose([stretched[0], upright[0]], 0.0, atol=1e-12)
    assert 40.0 < stretched[1] < 60.0
    assert -25.0 < stretched[3] < -10.0
    assert np.abs(upright).max() < 6.0
    assert np.abs(stretched[[4, 6]]).max() < 1.0


def test_a_file_without_masses_is_read_as_before():
    assert "link" not in WEIGHTLESS.split("dh:")[1].split("free:")[1]
    arm = arm_of(WEIGHTLESS)
    assert arm.masses is None
    assert arm.assumed == ()


@pytest.mark.parametrize("length", [1e-300, 1.0, 1e300])
def test_tolerances_are_each_links_own_and_down_has_any_length(length):
    text = SARCOS.replace(
        "{link: 3, mass_kg: 4.0, centre_m: [0, 0, 0.18]}",
        "{link: 3, mass_kg: 4.0, centre_m: [0, 0, 0.18], mass_tolerance_percent: 5, "
        "centre_tolerance_mm: 2}",
    ).replace("down: [-1, 0, 0], tolerance_deg: 3", f"down: [0, {3 * length}, {-4 * length}]")
    masses = arm_of(text).masses
    assert masses.mass_sd_kg[2] == pytest.approx(0.2)
    assert masses.centre_sd_m[2] == pytest.approx(0.002)
    assert masses.mass_sd_kg[4] == pytest.approx(0.5)
    np.testing.assert_allclose(masses.down, [0.0, 0.6, -0.8])


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("{link: 2, mass_kg: 1.0", "{link: 3, mass_kg: 1.0", "link 3 is listed in place of link 2"),
        ("  - {link: 7, mass_kg: 1.5, centre_m: [-0.05, 0, 0.02]}\n", "", "6 links for 7 D-H rows"),
        ("mass_kg: 4.0", "mass_kg: -4.0", "must be at least 0"),
        ("mass_kg: 4.0", "mass_kg: heavy", "must be a number"),
        ("[0, 0, 0.18]", "[0, 0, 180]", "metres"),
        ("[0, 0, 0.18]", "[0, 0.18]", "centre_m"),
        ("down: [-1, 0, 0]", "down: [0, 0, 0]", "points nowhere"),
        (
            "gravity: {down: [-1, 0, 0], tolerance_deg: 3}\n",
            "",
            "the direction of gravity is missing",
        ),
        ("mass_kg: 4.0,", "mass_kg: 4.0, weight: 3,", "weight"),
    ],
)
def test_what_is_wrong_is_named(old, new, complaint):
    assert complaint in str(one_mistake(arm_of, SARCOS, old, new))


def test_the_json_schema_says_where_a_centre_is_seen_from():
    definitions = json_schema("arm")["$defs"]
    assert (
        "along the joint's axis"
        in definitions["LinkModel"]["properties"]["centre_m"]["description"]
    )
    assert {"link", "mass_kg", "centre_m"} == set(definitions["LinkModel"]["required"])

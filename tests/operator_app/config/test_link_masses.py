"""What an arm file states of its links' weight: read in SI, refused with a remedy, absent from old files."""

from __future__ import annotations

import re
from importlib.resources import files

import numpy as np
import pytest

from operator_app.config.arm_file import load_arm, parse_arm
from operator_app.config.errors import ConfigError
from operator_app.config.json_schemas import json_schema
from solver.chain.kinematics import forward
from solver.chain.statics import LinkMasses, gravity_torque

SARCOS = (files("operator_app") / "data" / "arms" / "sarcos_dextrous.yaml").read_text("utf-8")
WEIGHTLESS = re.sub(r"^(?:gravity: |links:|  - \{link: ).*\n", "", SARCOS, flags=re.MULTILINE)


def masses_of(text: str) -> LinkMasses | None:
    return parse_arm(text.encode(), "a.yaml").masses


def test_the_packaged_arm_weighs_something() -> None:
    masses = load_arm("sarcos_dextrous").masses
    assert masses is not None
    assert masses.mass_kg.shape == (7,)
    np.testing.assert_allclose(masses.mass_sd_kg, 0.2 * masses.mass_kg)
    np.testing.assert_allclose(masses.centre_sd_m, 0.015)
    # As the virtual arm hangs: its first axis is level.
    np.testing.assert_array_equal(masses.down, [-1.0, 0.0, 0.0])
    assert masses.down_sd_rad == pytest.approx(np.deg2rad(3.0))
    # The centre of the upper arm lies on its own axis, half way to the elbow.
    np.testing.assert_allclose(masses.centre_m[2], [0.0, 0.0, 0.18])


def test_the_panda_hangs_on_its_second_and_fourth_joint() -> None:
    """Torques of the identified masses, stretched out: the maker states a payload of 3 kg at 87 N m."""
    arm = load_arm("franka_panda")
    assert arm.masses is not None
    table = arm.table
    theta = table.theta_off_rad + np.deg2rad([[0, 90, 0, 0, 0, 90, 0], [30, 0, 0, -4, 0, 0, 0]])
    frames = forward(theta, table.s_m, table.a_m, table.alpha_rad)
    stretched, upright = gravity_torque(frames, arm.masses)
    np.testing.assert_allclose([stretched[0], upright[0]], 0.0, atol=1e-12)
    assert 40.0 < stretched[1] < 60.0
    assert -25.0 < stretched[3] < -10.0
    assert np.abs(upright).max() < 6.0
    assert np.abs(stretched[[4, 6]]).max() < 1.0


def test_a_file_without_masses_is_read_as_before() -> None:
    assert "link" not in WEIGHTLESS.split("dh:")[1].split("free:")[1]
    arm = parse_arm(WEIGHTLESS.encode(), "a.yaml")
    assert arm.masses is None
    assert arm.assumed == ()


@pytest.mark.parametrize("length", [1e-300, 1.0, 1e300])
def test_tolerances_are_each_links_own_and_down_has_any_length(length: float) -> None:
    text = SARCOS.replace(
        "{link: 3, mass_kg: 4.0, centre_m: [0, 0, 0.18]}",
        "{link: 3, mass_kg: 4.0, centre_m: [0, 0, 0.18], mass_tolerance_percent: 5, "
        "centre_tolerance_mm: 2}",
    ).replace("down: [-1, 0, 0], tolerance_deg: 3", f"down: [0, {3 * length}, {-4 * length}]")
    masses = masses_of(text)
    assert masses is not None
    assert masses.mass_sd_kg[2] == pytest.approx(0.2)
    assert masses.centre_sd_m[2] == pytest.approx(0.002)
    assert masses.mass_sd_kg[4] == pytest.approx(0.5)
    np.testing.assert_allclose(masses.down, [0.0, 0.6, -0.8])


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("{link: 2, mass_kg: 1.0", "{link: 3, mass_kg: 1.0", "link 3 stands where link 2 belongs"),
        ("  - {link: 7, mass_kg: 1.5, centre_m: [-0.05, 0, 0.02]}\n", "", "6 links for 7 D-H rows"),
        ("mass_kg: 4.0", "mass_kg: -4.0", "must be at least 0"),
        ("mass_kg: 4.0", "mass_kg: heavy", "must be a number"),
        ("[0, 0, 0.18]", "[0, 0, 180]", "metres"),
        ("[0, 0, 0.18]", "[0, 0.18]", "centre_m"),
        ("down: [-1, 0, 0]", "down: [0, 0, 0]", "points nowhere"),
        ("gravity: {down: [-1, 0, 0], tolerance_deg: 3}\n", "", "no gravity says which way"),
        ("mass_kg: 4.0,", "mass_kg: 4.0, weight: 3,", "weight"),
    ],
)
def test_what_is_wrong_is_named(old: str, new: str, complaint: str) -> None:
    assert old in SARCOS
    with pytest.raises(ConfigError) as caught:
        masses_of(SARCOS.replace(old, new, 1))
    problems = [str(problem) for problem in caught.value.problems]
    assert len(problems) == 1
    assert complaint in problems[0]
    assert "a.yaml" in str(caught.value)


def test_the_json_schema_says_where_a_centre_is_seen_from() -> None:
    definitions = json_schema("arm")["$defs"]
    assert (
        "along the joint's axis"
        in definitions["LinkModel"]["properties"]["centre_m"]["description"]
    )
    assert {"link", "mass_kg", "centre_m"} == set(definitions["LinkModel"]["required"])

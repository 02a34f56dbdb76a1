"""Arm files: packaged arms match the paper and their makers; each mistake gives one problem."""

import math

import numpy as np
import pytest

from operator_app.config.arm_file import load_arm, parse_arm
from operator_app.config.resources import builtin_names, resolve
from solver.chain.kinematics import forward
from solver.chain.sensors import Encoder, NoSensor, Rvdt
from tests.oracles.makers_chains import CHAINS, flange
from tests.oracles.mistakes import is_within_replacement, named, parse_problems, single_problem

GOOD = resolve("arm", "sarcos_dextrous").data.decode()


def parse(text):
    return parse_arm(text.encode(), "arm.yaml")


class TestPackaged:
    def test_sarcos_matches_table_1(self):
        arm = load_arm("sarcos_dextrous")
        np.testing.assert_array_equal(arm.table.s_m[1:6], [0.0, 0.355, 0.0, 0.320, 0.0])
        np.testing.assert_array_equal(arm.table.a_m[:6], np.zeros(6))
        np.testing.assert_allclose(
            np.rad2deg(arm.table.alpha_rad[:6]), [90, -90, 90, -90, 90, -90], rtol=1e-15
        )
        np.testing.assert_allclose(
            np.rad2deg(arm.table.theta_off_rad), [10, -120, -20, -10, 30, 120, 90], rtol=1e-15
        )
        assert [e.name for e in arm.free] == [f"theta_off_{j}" for j in range(1, 8)]

    def test_sarcos_sensors_match_section_3(self):
        arm = load_arm("sarcos_dextrous")
        encoder = Encoder(counts_per_rev=400000, accuracy_rad=math.radians(0.01))
        full_scale_rad = math.radians(120.0)
        rvdt = Rvdt(
            bits=12, full_scale_rad=full_scale_rad, linearity=0.02, noise_lsb=2.0, gain=0.005
        )
        assert [j.sensor for j in arm.joints] == [encoder] * 5 + [rvdt] * 2
        ranges_rad = [j.upper_rad - j.lower_rad for j in arm.joints[5:]]
        assert ranges_rad == pytest.approx([full_scale_rad] * 2, rel=1e-14)

    @pytest.mark.parametrize("name", sorted(CHAINS))
    def test_flange_pose_matches_maker_description(self, name):
        arm, rng = load_arm(name), np.random.default_rng(4)
        # Frame 0 of the Gen3 is its base link rotated by 180 deg about x.
        base = np.diag([1.0, -1.0, -1.0, 1.0]) if name == "kinova_gen3" else np.eye(4)
        for q in rng.uniform(arm.lower_rad, arm.upper_rad, (20, arm.joint_count)):
            frames = forward(q + arm.table.theta_off_rad, *arm.table.stacked()[1:])
            expected = base @ flange(name, q)
            np.testing.assert_allclose(frames.p_end, expected[:3, 3], rtol=0, atol=1e-9)
            np.testing.assert_allclose(frames.R_end, expected[:3, :3], rtol=0, atol=1e-9)

    @pytest.mark.parametrize("name", builtin_names("arm"))
    def test_packaged_arm_is_complete(self, name):
        arm, text = load_arm(name), resolve("arm", name).data.decode()
        assert arm.name == name
        assert np.all(arm.home_rad > arm.lower_rad)
        assert np.all(arm.home_rad < arm.upper_rad)
        assert not arm.home_rad.flags.writeable
        assert "source: >-" in text
        assert arm.assumed == ()
        assert [e.name for e in arm.free] == [
            f"theta_off_{j}" for j in range(1, arm.joint_count + 1)
        ]
        parallel = {"ur5e": (2, 3), "ur10e": (2, 3), "xarm6": (2,), "abb_irb120": (2,)}
        assert arm.hayati_rows == parallel.get(name, (2,) if name == "kinova_gen3_lite" else ())


BAD = [
    ("home_deg:", "home_degrees:", "home_degrees"),
    ("a_m: 0,       alpha_deg: -90}", "a_mm: 0, alpha_deg: -90}", "dh[row 2].a_mm"),
    ("s_m: 0.355", "s_m: -38.5", "dh[row 3].s_m"),
    ("s_m: 0.320", "s_m: 320", "dh[row 5].s_m"),
    ("a_m: 0,       alpha_deg: -90}", "a_m: 0, alpha_deg: -1.5708}", "dh[row 2].alpha_deg"),
    *(("dh:", f"offset_tolerance_deg: {value}\ndh:", "offset_tolerance_deg") for value in ("unknow", "-3", "true")),
    *(("s_m: 0.355", f"s_m: {value}", "dh[row 3].s_m")
      for value in ("long", "", "[1]", "true", "12:30", "010", "355 mm")),
    ("range_deg: [-35, 115]", "range_deg: ['-35,5', 115]", "joints[joint 1].range_deg[1]"),
    ("{row: 3, theta_off_deg: -20,  ", "{row: 3, ", "dh[row 3].theta_off_deg"),
    ("row: 3", "row: 4", "dh[row 4].row"),
    ("- joint: 2", "- joint: 3", "joints[joint 3].joint"),
    ("free: [theta_off_1", "free: [theta_off_01", "free[1]"),
    ("kind: rvdt", "kind: rdvt", "joints[joint 6].sensor"),
    ("{kind: rvdt, bits: 12,", "{bits: 12,", "joints[joint 6].sensor"),
    ("bits: 12", "bit: 12", "joints[joint 6].sensor.bit"),
    ("full_scale_deg: 120", "full_scale_deg: 2.0944", "joints[joint 6].sensor.full_scale_deg"),
    ("full_scale_deg: 120", "full_scale_rad: 2.0944", "joints[joint 6].sensor.full_scale_rad"),
    ("max_torque_nm: 100", "max_torque: 100", "joints[joint 1].max_torque"),
    ("[-35, 115]", "[115, -35]", "joints[joint 1].range_deg"),
    ("[-35, 115]", "[-0.61, 2.0]", "joints[joint 1].range_deg"),
    ("[-35, 115]", "[115]", "joints[joint 1].range_deg[2]"),
    ("max_speed_deg_per_s: 180", "max_speed_deg_per_s: -180", "joints[joint 1].max_speed_deg_per_s"),
    ("counts_per_rev: 400000", "counts_per_rev: 4000.5", "joints[joint 1].sensor.counts_per_rev"),
    ("[theta_off_1,", "[theta_of_1,", "free[1]"),
    ("theta_off_2,", "theta_off_1,", "free[2]"),
    ("theta_off_2,", "theta_off_9,", "free[2]"),
    ("theta_off_2,", "a_0,", "free[2]"),
    ("[40.5311, ", "[140.5311, ", "home_deg[1]"),
    ("[40.5311, ", "[", "home_deg"),
    ("[40.5311, ", "[45034, ", "home_deg[1]"),
    *(("{length_mm: 0.5,", f"{{{text},", f"tolerance.{text.partition(':')[0]}")
      for text in ("length_mm: -0.5", "length_mm: 60", "length_m: 0.0005")),
    *(("twist_deg: 0.1}", f"twist_deg: {value}}}", "tolerance.twist_deg") for value in ("12", ".nan")),
    *(("tolerance: {length_mm: 0.5, twist_deg: 0.1}", f"tolerance: {value}", "tolerance") for value in ("1", "false")),
    ("accuracy_deg: 0.01", "accuracy_deg: 11", "joints[joint 1].sensor.accuracy_deg"),
    ("noise_lsb: 2,", "noise_lsb: 2, accuracy_deg: 0.01,", "joints[joint 6].sensor.accuracy_deg"),
    *(("gain: 0.005", f"gain: {value}", "joints[joint 6].sensor.gain") for value in ("0.6", "-0.1")),
    ("backlash_deg: 0.01", "backlash_deg: -1", "joints[joint 1].backlash_deg"),
    ("sag_deg: 0.01", "sag_deg: much", "joints[joint 1].sag_deg"),
    ("{link: 2, mass_kg: 1.0", "{link: 3, mass_kg: 1.0", "links[2].link"),
    ("  - {link: 7, mass_kg: 1.5, centre_m: [-0.05, 0, 0.02]}\n", "", "links"),
    *(("mass_kg: 4.0", f"mass_kg: {value}", "links[3].mass_kg") for value in ("-4.0", "heavy")),
    *(("[0, 0, 0.18]", value, "links[3].centre_m[3]") for value in ("[0, 0, 180]", "[0, 0.18]")),
    ("mass_kg: 4.0,", "mass_kg: 4.0, weight: 3,", "links[3].weight"),
    ("down: [-1, 0, 0]", "down: [0, 0, 0]", "gravity.down"),
    ("gravity: {down: [-1, 0, 0], tolerance_deg: 3}\n", "", "links"),
    ("sarcal/arm/1", "sarcal/fixture/1", "schema"),
    ("sarcal/arm/1", "sarcal/arm/2", "schema"),
    ("schema: sarcal/arm/1\n", "", ""),
    ("schema: sarcal/arm/1\nname: sarcos_dextrous\n", "name: sarcos_dextrous\nschema: sarcal/arm/1\n", "schema"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "key"), BAD, ids=named(BAD))
def test_one_mistake_gives_one_problem_with_line_and_key(old, new, key, approve):
    problem = single_problem(parse, GOOD, old, new)
    assert problem.key == key
    assert key == "links" or is_within_replacement(problem, GOOD, old, new)
    approve(str(problem))


def test_all_problems_are_listed_in_file_order():
    text = GOOD
    for old, new in (
        ("s_m: 0.355", "s_m: .nan"),
        ("a_m: 0,       alpha_deg: -90}", "a_mm: 0, alpha_deg: -90}"),
        ("range_deg: [-35, 115]", "range_deg: [115, -35]"),
        ("bits: 12", "bits: yes"),
        ("free: [theta_off_1,", "free: [theta_of_1,"),
    ):
        text = text.replace(old, new, 1)
    text += "colour: red\nname: again\n"
    problems = parse_problems(parse, text)
    assert [p.key for p in problems] == [
        "dh[row 2].a_mm",
        "dh[row 3].s_m",
        "joints[joint 1].range_deg",
        "joints[joint 6].sensor.bits",
        "free[1]",
        "colour",
        "name",
    ]


def test_joint_and_row_numbers_must_correspond():
    start = GOOD.index("  - joint: 7")
    text = GOOD[:start] + GOOD[GOOD.index("# What a calibration") :]
    problems = parse_problems(parse, text)
    assert [p.key for p in problems] == ["joints", "home_deg"]
    assert "6 joints for 7 D-H rows" in problems[0].text


def test_offset_of_joint_without_sensor_cannot_be_free():
    sensor = (
        "{kind: rvdt, bits: 12, full_scale_deg: 120, linearity: 0.02, noise_lsb: 2, gain: 0.005}"
    )
    problem = single_problem(parse, GOOD, sensor, "{kind: none}")
    assert problem.key == "free[6]"
    assert "no sensor" in problem.text
    arm = parse(GOOD.replace(sensor, "{kind: none}", 1).replace(" theta_off_6,", "", 1))
    assert isinstance(arm.joints[5].sensor, NoSensor)


PARALLEL = GOOD.replace("s_m: 0.0,", "s_m: 0,").replace("alpha_deg: -90", "alpha_deg: ROW", 1)


class TestHayati:
    @pytest.mark.parametrize(
        ("twist", "rows"),
        [("0", (2,)), ("180", (2,)), ("9.9", (2,)), ("-170.1", (2,)), ("10.1", ()), ("-90", ())],
    )
    def test_row_between_parallel_axes_has_beta_instead_of_s(self, twist, rows):
        arm = parse(PARALLEL.replace("ROW", twist))
        assert arm.hayati_rows == rows
        assert {e.name for e in arm.maker_entries(2)} == (
            {"a_2", "alpha_2", "beta_2"} if rows else {"a_2", "s_2", "alpha_2"}
        )
        assert not arm.table.beta_rad.any()

    def test_stated_beta_makes_any_row_but_the_last_hayati(self):
        text = PARALLEL.replace("ROW", "-90, beta_deg: 0.25")
        arm = parse(text)
        without_s = parse(text.replace("s_m: 0,", "", 1))
        np.testing.assert_array_equal(without_s.table.stacked(), arm.table.stacked())
        assert arm.hayati_rows == (2,)
        assert np.rad2deg(arm.table.beta_rad).tolist() == [0.0, 0.25] + [0.0] * 5
        problem = single_problem(parse, GOOD, "{row: 7,", "{beta_deg: 0.1, row: 7,")
        assert problem.key == "dh[row 7].beta_deg"

    def test_free_s_of_hayati_row_becomes_free_beta(self):
        text = PARALLEL.replace("ROW", "0").replace("free: [", "free: [s_2, beta_2, s_3, ")
        assert [e.name for e in parse(text).free[:3]] == ["beta_2", "s_3", "theta_off_1"]

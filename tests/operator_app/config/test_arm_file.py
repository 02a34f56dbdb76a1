"""Arm files: the packaged ones say what Table 1 and the maker say; bad ones get one clear complaint."""

import math
from collections.abc import Callable
from importlib.resources import files

import numpy as np
import pytest

from operator_app.config.arm_file import load_arm, parse_arm
from operator_app.config.errors import ConfigError
from operator_app.config.resources import builtin_names, resolve
from solver.chain.kinematics import forward
from solver.chain.sensors import Encoder, NoSensor, Rvdt
from tests.oracles.makers_chains import CHAINS, flange

GOOD = (files("operator_app") / "data" / "arms" / "sarcos_dextrous.yaml").read_text("utf-8")


def complaint(text: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        parse_arm(text.encode(), "arm.yaml")
    return caught.value


def line_of(text: str, part: str) -> int:
    return next(k for k, line in enumerate(text.splitlines(), 1) if part in line)


class TestPackaged:
    def test_sarcos_is_table_1(self):
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

    def test_sarcos_sensors_are_those_of_section_3(self):
        arm = load_arm("sarcos_dextrous")
        encoder = Encoder(counts_per_rev=400000, accuracy_rad=math.radians(0.01))
        assert [j.sensor for j in arm.joints[:5]] == [encoder] * 5
        for joint in arm.joints[5:]:
            assert isinstance(joint.sensor, Rvdt)
            assert joint.sensor.bits == 12
            assert joint.sensor.linearity == 0.02
            assert joint.sensor.noise_lsb == 2.0
            assert joint.sensor.gain == 0.005
            assert joint.sensor.full_scale_rad == pytest.approx(
                joint.upper_rad - joint.lower_rad, rel=1e-14
            )

    @pytest.mark.parametrize("name", sorted(CHAINS))
    def test_flange_is_where_the_makers_description_has_it(self, name):
        arm, rng = load_arm(name), np.random.default_rng(4)
        # The Gen3's frame 0 is its base link turned half round about x; the others' are their base links.
        base = np.diag([1.0, -1.0, -1.0, 1.0]) if name == "kinova_gen3" else np.eye(4)
        for q in rng.uniform(arm.lower_rad, arm.upper_rad, (20, arm.joint_count)):
            frames = forward(q + arm.table.theta_off_rad, *arm.table.stacked()[1:])
            theirs = base @ flange(name, q)
            np.testing.assert_allclose(frames.p_end, theirs[:3, 3], rtol=0, atol=1e-9)
            np.testing.assert_allclose(frames.R_end, theirs[:3, :3], rtol=0, atol=1e-9)

    @pytest.mark.parametrize("name", builtin_names("arm"))
    def test_what_is_packaged_says_from_where_and_knows_parallel_axes(self, name):
        arm, text = load_arm(name), resolve("arm", name).data.decode()
        assert "source: >-" in text
        assert [e.name for e in arm.free] == [
            f"theta_off_{j}" for j in range(1, arm.joint_count + 1)
        ]
        parallel = {"ur5e": (2, 3), "ur10e": (2, 3), "xarm6": (2,), "abb_irb120": (2,)}
        assert arm.hayati_rows == parallel.get(name, (2,) if name == "kinova_gen3_lite" else ())

    @pytest.mark.parametrize("name", builtin_names("arm"))
    def test_home_is_inside_the_ranges(self, name):
        arm = load_arm(name)
        assert arm.name == name
        assert np.all(arm.home_rad > arm.lower_rad)
        assert np.all(arm.home_rad < arm.upper_rad)
        assert not arm.home_rad.flags.writeable


def replace(old: str, new: str) -> Callable[[str], str]:
    def edit(text: str) -> str:
        assert text.count(old) >= 1
        return text.replace(old, new, 1)

    return edit


# What is done to a good file; where the one complaint must be; what it must say.
BAD: list[tuple[str, Callable[[str], str], str, str, str]] = [
    ("unknown key", replace("home_deg:", "home_degrees:"), "home_degrees:", "home_degrees"),
    (
        "millimetres key",
        replace("a_m: 0,       alpha_deg: -90}", "a_mm: 0, alpha_deg: -90}"),
        "a_mm",
        "dh[row 2].a_mm",
    ),
    (
        "degrees where metres belong",
        replace("s_m: 0.355", "s_m: -38.5"),
        "s_m: -38.5",
        "dh[row 3].s_m",
    ),
    (
        "millimetres in a metre key",
        replace("s_m: 0.320", "s_m: 320"),
        "s_m: 320",
        "dh[row 5].s_m",
    ),
    (
        "radians in a degree key",
        replace("a_m: 0,       alpha_deg: -90}", "a_m: 0, alpha_deg: -1.5708}"),
        "-1.5708",
        "dh[row 2].alpha_deg",
    ),
    ("nan", replace("s_m: 0.355", "s_m: .nan"), ".nan", "dh[row 3].s_m"),
    ("infinity", replace("s_m: 0.355", "s_m: -.inf"), "-.inf", "dh[row 3].s_m"),
    ("overflow", replace("s_m: 0.355", "s_m: 1e999"), "1e999", "dh[row 3].s_m"),
    *(
        (
            f"zeros known to {value}",
            replace("dh:", f"offset_tolerance_deg: {value}\ndh:"),
            "offset_tolerance_deg",
            "offset_tolerance_deg",
        )
        for value in ("unknow", "-3", "true")
    ),
    ("text", replace("s_m: 0.355", "s_m: long"), "long", "dh[row 3].s_m"),
    ("null", replace("s_m: 0.355", "s_m: "), "row: 3", "dh[row 3].s_m"),
    ("list", replace("s_m: 0.355", "s_m: [1]"), "row: 3", "dh[row 3].s_m"),
    ("bool", replace("s_m: 0.355", "s_m: true"), "row: 3", "dh[row 3].s_m"),
    ("sexagesimal", replace("s_m: 0.355", "s_m: 12:30"), "row: 3", "dh[row 3].s_m"),
    ("octal", replace("s_m: 0.355", "s_m: 010"), "row: 3", "dh[row 3].s_m"),
    ("comma", replace("range_deg: [-35, 115]", "range_deg: ['-35,5', 115]"), "-35,5",
     "joints[joint 1].range_deg[1]"),
    ("unit in value", replace("s_m: 0.355", "s_m: 355 mm"), "row: 3", "dh[row 3].s_m"),
    ("missing key", replace("{row: 3, theta_off_deg: -20,  ", "{row: 3, "), "row: 3",
     "dh[row 3].theta_off_deg"),
    ("row order", replace("row: 3", "row: 4"), "row: 4", "dh[row 4].row"),
    ("duplicate key", replace("name: sarcos_dextrous\n", "name: sarcos_dextrous\nname: b\n"), "name: b",
     "name"),
    ("sensor kind", replace("kind: rvdt", "kind: rdvt"), "rdvt", "joints[joint 6].sensor"),
    ("sensor without kind", replace("{kind: rvdt, bits: 12,", "{bits: 12,"), "{bits: 12",
     "joints[joint 6].sensor"),
    ("sensor key", replace("bits: 12", "bit: 12"), "bit: 12", "joints[joint 6].sensor.bit"),
    ("full scale in rad", replace("full_scale_deg: 120", "full_scale_deg: 2.0944"), "2.0944",
     "joints[joint 6].sensor.full_scale_deg"),
    ("sensor unit", replace("full_scale_deg: 120", "full_scale_rad: 2.0944"), "full_scale_rad",
     "joints[joint 6].sensor.full_scale_rad"),
    ("missing unit", replace("max_torque_nm: 100", "max_torque: 100"), "max_torque: 100",
     "joints[joint 1].max_torque"),
    ("range backwards", replace("[-35, 115]", "[115, -35]"), "[115, -35]",
     "joints[joint 1].range_deg"),
    ("range in rad", replace("[-35, 115]", "[-0.61, 2.0]"), "-0.61", "joints[joint 1].range_deg"),
    ("range of one", replace("[-35, 115]", "[115]"), "[115]", "joints[joint 1].range_deg[2]"),
    ("negative speed", replace("max_speed_deg_per_s: 180", "max_speed_deg_per_s: -180"), "-180",
     "joints[joint 1].max_speed_deg_per_s"),
    ("fraction", replace("counts_per_rev: 400000", "counts_per_rev: 4000.5"), "4000.5",
     "joints[joint 1].sensor.counts_per_rev"),
    ("free entry", replace("[theta_off_1,", "[theta_of_1,"), "theta_of_1", "free[1]"),
    ("free twice", replace("theta_off_2,", "theta_off_1,"), "theta_off_1, theta_off_1", "free[2]"),
    ("free row", replace("theta_off_2,", "theta_off_9,"), "theta_off_9", "free[2]"),
    ("free of the fixture", replace("theta_off_2,", "a_0,"), "a_0,", "free[2]"),
    ("home outside", replace("[40.5311, ", "[140.5311, "), "140.5311", "home_deg[1]"),
    ("home of six", replace("[40.5311, ", "["), "home_deg", "home_deg"),
    ("counts as degrees", replace("[40.5311, ", "[45034, "), "45034", "home_deg[1]"),
    ("schema of a fixture", replace("sarcal/arm/1", "sarcal/fixture/1"), "schema:", "schema"),
    ("newer schema", replace("sarcal/arm/1", "sarcal/arm/2"), "schema:", "schema"),
    ("no schema", replace("schema: sarcal/arm/1\n", ""), "name:", ""),
    ("schema not first", replace("schema: sarcal/arm/1\nname: sarcos_dextrous\n",
                                 "name: sarcos_dextrous\nschema: sarcal/arm/1\n"), "schema:", "schema"),
    ("tab", replace("    name: shoulder 1", "\tname: shoulder 1"), "\tname", ""),
    ("open bracket", replace("[-35, 115]", "[-35, 115"), "sensor: {kind: encoder", ""),
    ("alias", replace("[-35, 115]", "*range"), "*range", ""),
    ("anchor", replace("[-35, 115]", "&range [-35, 115]"), "&range", ""),
    ("tag", replace("name: sarcos", "name: !!python/object:os.system sarcos"), "!!python", ""),
    ("two documents", lambda text: text + "---\na: 1\n", "---", ""),
]  # fmt: skip


@pytest.mark.parametrize(("edit", "where", "key"), [b[1:] for b in BAD], ids=[b[0] for b in BAD])
def test_one_mistake_gives_one_complaint_with_line_and_key(edit, where, key, approve):
    text = edit(GOOD)
    error = complaint(text)
    assert len(error.problems) == 1, str(error)
    problem = error.problems[0]
    assert problem.line == line_of(text, where), str(error)
    assert problem.key == key
    approve(str(problem))
    assert str(problem).startswith(f"arm.yaml:{problem.line}: ")


def test_everything_wrong_is_listed_at_once_in_file_order():
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
    error = complaint(text)
    assert [p.key for p in error.problems] == [
        "dh[row 2].a_mm",
        "dh[row 3].s_m",
        "joints[joint 1].range_deg",
        "joints[joint 6].sensor.bits",
        "free[1]",
        "colour",
        "name",
    ]
    assert str(error).count("\n") == 6


def test_joints_and_rows_belong_together():
    start = GOOD.index("  - joint: 7")
    text = GOOD[:start] + GOOD[GOOD.index("# What a calibration") :]
    error = complaint(text)
    assert [p.key for p in error.problems] == ["joints", "home_deg"]
    assert "6 joints for 7 D-H rows" in error.problems[0].text
    (problem,) = complaint(GOOD.replace("- joint: 2", "- joint: 3", 1)).problems
    assert problem.key == "joints[joint 3].joint"
    assert "in place of joint 2" in problem.text
    (problem,) = complaint(GOOD.replace("free: [theta_off_1", "free: [theta_off_01", 1)).problems
    assert (problem.key, problem.remedy) == ("free[1]", "write theta_off_1")


def test_unsensed_joint_has_no_offset_to_free():
    sensor = (
        "{kind: rvdt, bits: 12, full_scale_deg: 120, linearity: 0.02, noise_lsb: 2, gain: 0.005}"
    )
    text = GOOD.replace(sensor, "{kind: none}", 1)
    (problem,) = complaint(text).problems
    assert problem.key == "free[6]"
    assert "no sensor" in problem.text
    arm = parse_arm(text.replace(" theta_off_6,", "", 1).encode(), "arm.yaml")
    assert isinstance(arm.joints[5].sensor, NoSensor)


PARALLEL = GOOD.replace("s_m: 0.0,", "s_m: 0,").replace("alpha_deg: -90", "alpha_deg: ROW", 1)


class TestHayati:
    """Row 2 of the packaged arm with another twist."""

    @pytest.mark.parametrize(
        ("twist", "rows"),
        [("0", (2,)), ("180", (2,)), ("9.9", (2,)), ("-170.1", (2,)), ("10.1", ()), ("-90", ())],
    )
    def test_a_row_between_parallel_axes_has_beta_in_place_of_s(self, twist, rows):
        arm = parse_arm(PARALLEL.replace("ROW", twist).encode(), "arm.yaml")
        assert arm.hayati_rows == rows
        assert {e.name for e in arm.maker_entries(2)} == (
            {"a_2", "alpha_2", "beta_2"} if rows else {"a_2", "s_2", "alpha_2"}
        )
        assert not arm.table.beta_rad.any()

    def test_a_stated_beta_makes_one_of_any_row_but_the_last(self):
        text = PARALLEL.replace("ROW", "-90, beta_deg: 0.25")
        arm = parse_arm(text.encode(), "arm.yaml")
        without_s = parse_arm(text.replace("s_m: 0,", "", 1).encode(), "arm.yaml")
        np.testing.assert_array_equal(without_s.table.stacked(), arm.table.stacked())
        assert arm.hayati_rows == (2,)
        assert np.rad2deg(arm.table.beta_rad).tolist() == [0.0, 0.25] + [0.0] * 5
        last = GOOD.replace("{row: 7,", "{beta_deg: 0.1, row: 7,")
        assert complaint(last).problems[0].key == "dh[row 7].beta_deg"

    def test_where_a_file_frees_s_between_parallel_axes_beta_is_free(self):
        text = PARALLEL.replace("ROW", "0").replace("free: [", "free: [s_2, beta_2, s_3, ")
        arm = parse_arm(text.encode(), "arm.yaml")
        assert [e.name for e in arm.free[:3]] == ["beta_2", "s_3", "theta_off_1"]

"""Chains of makers' URDFs: any frames, parallel axes, rounded angles, torsos, grippers. Oracle: pinocchio."""

import numpy as np
import pytest

from operator_app.config.arm_file import parse_arm
from operator_app.config.atomic import dump_strict
from operator_app.config.errors import ConfigError
from operator_app.config.urdf_editing import format_urdf
from operator_app.config.urdf_reading import arm_file_of, parse_urdf
from operator_app.config.urdf_rows import exact_deg, origin_words, rotation_of_rpy
from tests.oracles.urdfs import joint, robot, tip_error, words

HALF = "1.5707963267948966"
SIX = (("0 0 0.0892", "0 0 0"), ("0 0.1358 0", f"0 {HALF} 0"), ("0 -0.1197 0.425", "0 0 0"),
       ("0 0 0.39225", f"0 {HALF} 0"), ("0 0.093 0", "0 0 0"), ("0 0 0.09465", "0 0 0"))  # fmt: skip
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0")
"""A common six-axis arm: axes 2, 3 and 4 are parallel."""


def six_joints(changes=None):
    """Joints j1 to j6 between links l0 to l6, and a flange; `changes` are other origins by number."""
    origins = dict(enumerate(SIX, 1)) | (changes or {})
    joints = [
        joint(f"j{k}", f"l{k - 1}", f"l{k}", *origins[k], axis=AXES[k - 1]) for k in range(1, 7)
    ]
    return [*joints, joint("end", "l6", "flange", "0 0.0823 0", f"0 0 {HALF}", kind="fixed")]


def foreign_urdf(seed: int) -> str:
    rng = np.random.default_rng(seed)
    joints = [joint("stand", "world", "l0", "0.1 -0.2 0.4", "0.1 0.2 0.3", kind="fixed")]
    for j in range(1, 8):
        axis = rng.normal(size=3) if seed else np.eye(3)[rng.integers(3)] * rng.choice([-1, 1])
        xyz = rng.uniform(-0.3, 0.3, 3) if seed else np.eye(3)[rng.integers(3)] * 0.2
        rpy = rng.uniform(-3, 3, 3) if seed else np.pi / 2 * rng.integers(-2, 3, 3)
        limits = {"ends": (-2.9, 2.9), "effort": 30, "velocity": 1.5}
        joints.append(joint(f"j{j}", f"l{j - 1}", f"l{j}", *map(words, (xyz, rpy, axis)), **limits))
    tool = joint("tool", "l7", "tool0", "0.01 0.02 0.045", "0.3 -0.2 0.5", kind="fixed")
    return robot(*joints, tool)


@pytest.mark.parametrize("seed", range(8))
def test_foreign_urdf_is_read_as_the_same_chain(seed):
    urdf = foreign_urdf(seed).encode()
    chain = parse_urdf(urdf, "foreign")
    assert (chain.base, chain.tip) == ("world", "tool0")
    assert tip_error(urdf, chain, chain.table) < 1e-9
    first = chain.joints[0]
    assert (first.lower_rad, first.upper_rad) == (-2.9, 2.9)
    assert (first.velocity_rad_per_s, first.effort_nm) == (1.5, 30.0)


@pytest.mark.parametrize("error_rad", [0.0, 1e-10, 1e-5, -2e-3, 0.1])
def test_nearly_parallel_axes_have_moderate_lengths(error_rad):
    data = robot(
        *six_joints({3: ("0 -0.1197 0.425", f"{error_rad!r} 0 {-0.5 * error_rad!r}")})
    ).encode()
    chain = parse_urdf(data, "arm.urdf")
    arm = parse_arm(dump_strict(dict(arm_file_of(chain, name="arm"))), "arm")
    assert arm.hayati_rows == (2, 3)
    assert np.abs(chain.table.stacked()[1:3]).max() < 0.5
    assert tip_error(data, chain, arm.table) < 1e-9
    # Row 2 has no s; the deviation from parallel is a twist about x and one about y.
    assert chain.table.s_m[1] == 0.0
    twist = np.hypot(chain.table.beta_rad[1], chain.table.alpha_rad[1])
    assert twist == pytest.approx(abs(error_rad) * np.hypot(1.0, 0.5), rel=1e-2, abs=1e-12)
    read_back = parse_urdf(format_urdf(arm, arm.table), "read_back.urdf")
    np.testing.assert_allclose(read_back.table.stacked(), arm.table.stacked(), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("word", "deg"),
    [("1.5708", 90), ("-3.1416", -180), ("0.7854", 45), ("1.57079", 90), ("3.14159", 180),
     ("-1.57079632679", -90), ("1.570796327", 90), ("3.14", 180), ("0.2618", 15), ("2.35619", 135),
     ("1.57080632", None), ("0.785", None), ("1.5709", None), ("0.79", None), ("0", None),
     ("0.0", None), ("0.0000", None), ("1.5", None), (HALF, None), ("1e-5", None), ("3.1", None)],
)  # fmt: skip
def test_rounded_angle_is_read_as_exact(word, deg):
    assert exact_deg(word) == deg


def test_rounded_half_turn_is_reported():
    chain = parse_urdf(
        robot(*six_joints({3: ("0 -0.1197 0.425", "-3.1416 0 0")})).encode(), "arm.urdf"
    )
    assert chain.rounded == {"-3.1416": -180.0}
    assert abs(chain.table.alpha_rad[1]) == np.pi
    assert not chain.table.beta_rad.any()


@pytest.mark.parametrize("pitch", [0.0, 0.3, np.pi / 2, -np.pi / 2, 1.5707, 3.0])
def test_roll_pitch_yaw_is_read_back_at_any_pitch(pitch):
    T = np.eye(4)
    T[:3, :3] = rotation_of_rpy(np.array([0.4, pitch, -2.2]))
    T[:3, 3] = (0.1, -0.2, 1e-18)
    words = origin_words(T)
    assert words["xyz"] == "0.1 -0.2 0"
    read_back = rotation_of_rpy(np.array([float(w) for w in words["rpy"].split()]))
    assert np.abs(read_back - T[:3, :3]).max() < 1e-15


HAND = (
    joint("hand_joint", "flange", "hand", kind="fixed"),
    joint("finger_joint1", "hand", "left", axis="0 1 0", kind="prismatic"),
    joint("finger_joint2", "hand", "right", axis="0 1 0", kind="prismatic",
          more='<mimic joint="finger_joint1"/>'),
    joint("tcp", "hand", "hand_tcp", "0 0 0.1", kind="fixed"),
)  # fmt: skip
JAW = (joint("gripper", "flange", "jaw", axis="0 1 0"),)
TORSO = (joint("torso_lift", "torso", "l0", axis="0 0 1", kind="prismatic"),)
HEAD = (joint("neck", "torso", "head", axis="0 0 1"),)


@pytest.mark.parametrize(
    ("more", "base", "tip", "expected"),
    [
        (HAND, "", "", ("l0", "hand_tcp")),
        (HAND, "", "flange", ("l0", "flange")),
        (JAW, "", "", ("l0", "flange")),
        ((*TORSO, *HEAD), "l0", "", ("l0", "flange")),
        ((*TORSO, *HEAD, *HAND), "l0", "hand", ("l0", "hand")),
        ((), "l0", "l6", ("l0", "l6")),
    ],
)
def test_chain_has_joints_between_base_and_tip_only(more, base, tip, expected):
    chain = parse_urdf(robot(*six_joints(), *more).encode(), "arm.urdf", base=base, tip=tip)
    assert (chain.base, chain.tip) == expected
    assert [j.name for j in chain.joints] == ["j1", "j2", "j3", "j4", "j5", "j6"]


def test_simulator_joints_and_placeholder_limits_are_ignored():
    nested = "<gazebo><joint name='screw' type='screw'><parent>l1</parent></joint></gazebo>"
    unlimited = joint("j1", "l0", "l1", axis="0 0 1", ends=(-1e6, 1.0), velocity=100, effort=0)
    simulated = joint("j2", "l1", "l2", axis="0 1 0", velocity=-1, effort=1e7)
    joints = unlimited, simulated, *six_joints()[2:]
    chain = parse_urdf(robot(*joints, nested, nested).encode(), "arm.urdf")
    assert [j.name for j in chain.joints] == [f"j{k}" for k in range(1, 7)]
    first = chain.joints[0]
    assert (first.lower_rad, first.upper_rad, first.velocity_rad_per_s) == (-np.pi, 1.0, None)
    assert chain.unstated == [
        "j1: range of -1e+06 to 1 rad, velocity of 100 rad/s, no effort",
        "j2: no velocity, effort of 1e+07 N m",
    ]
    parse_arm(dump_strict(dict(arm_file_of(chain, name="arm"))), "arm")


TWO_MORE_ENDS = (
    '<joint name="s" type="fixed"><parent link="l7"/><child link="tool1"/></joint>'
    '<joint name="u" type="fixed"><parent link="l6"/><child link="eye"/></joint>'
)
DUPLICATE_NAME = (*six_joints()[:2], six_joints()[2].replace('"j3"', '"j2"'), *six_joints()[3:])


@pytest.mark.parametrize(
    ("urdf", "base", "tip"),
    [
        *(
            pytest.param(foreign_urdf(1).replace(old, new), "", "", id=name)
            for name, old, new in (
                ("model", "<robot", "<model"),
                ("prismatic", 'name="j1" type="revolute"', 'name="j1" type="prismatic"'),
                ("prismatic elbow", 'name="j4" type="revolute"', 'name="j4" type="prismatic"'),
                ("mimic elbow", '<parent link="l3"', '<mimic joint="j1"/><parent link="l3"'),
                ("range", 'lower="-2.9"', 'lower="3.0"'),
                ("two numbers", 'xyz="0.1 -0.2 0.4"', 'xyz="0.1 -0.2"'),
                ("entity", "<robot", "<!DOCTYPE x [<!ENTITY a 'b'>]><robot"),
                ("three ends", '<link name="world"/>', TWO_MORE_ENDS),
            )
        ),
        *(
            pytest.param(robot(*joints), base, tip, id=name)
            for name, joints, base, tip in (
                ("lift below the arm", (*six_joints(), *TORSO), "", "flange"),
                ("no such tip", six_joints(), "", "elbow"),
                ("no such base", six_joints(), "elbow", ""),
                ("base beside the arm", (*six_joints(), *HEAD), "head", "flange"),
                ("two ends", (*six_joints(), *HEAD, *TORSO), "", ""),
                ("no joint", (*six_joints(), *JAW), "", "l0"),
                ("duplicate name", DUPLICATE_NAME, "", ""),
                ("two parents", (*six_joints(), joint("other", "l0", "l3", axis="0 0 1")), "", ""),
            )
        ),
        pytest.param('<robot name="ur3"><link name="base"/></robot>', "", "", id="one link"),
    ],
)
def test_invalid_urdf_or_chain_is_refused(urdf, base, tip, approve):
    with pytest.raises(ConfigError) as caught:
        parse_urdf(urdf.encode(), "arm.urdf", base=base, tip=tip)
    approve(str(caught.value))

"""Calibrations written into a user's URDF, xacro or UR file: what changes and what pinocchio computes."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from operator_app.config.arm_file import parse_arm
from operator_app.config.atomic import dump_strict
from operator_app.config.errors import ConfigError
from operator_app.config.urdf_editing import chain_of, entries_without_origin, with_calibration
from operator_app.config.urdf_reading import arm_file_of, parse_urdf
from solver.chain.kinematics import DhTable
from tests.oracles.urdfs import joint, robot, tip_error, words

URDF = """<?xml version='1.0'?>\r
<!-- maker's comment <origin xyz="9 9 9"/> -->\r
<robot name="six" xmlns:xacro="http://ros.org/wiki/xacro">\r
  <link name="world"/><link name="l0"><inertial><origin xyz="1 2 3"/><mass value="4"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="stand" type="fixed"><parent link="world"/><child link="l0"/>
    <origin xyz="0.1 -0.2 0.4" rpy="0.1 0.2 0.3"/></joint>
  <joint name="pan" type="revolute"><parent link="l0"/><child link="l1"/>
    <origin  rpy='0 0 0.5'  xyz='0 0 0.0892'/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="9" velocity="2"/></joint>
  <link name="l1"><visual><origin xyz="0 0 0.1" rpy="0 0 0"/><geometry><box size="1 1 1"/></geometry></visual></link>
  <joint name="lift" type="revolute"><parent link="l1"/><child link="l2"/>
    <origin xyz="0 0.1358 0" rpy="0 1.5708 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="2"/></joint>
  <link name="l2"/>
  <joint name="spacer" type="fixed"><parent link="l2"/><child link="l2b"/><origin xyz="0 -0.1 0.2"/></joint>
  <link name="l2b"/>
  <joint name="elbow" type="revolute"><origin xyz="0 -0.0197 0.225"/><parent link="l2b"/><child link="l3"/>
    <axis xyz="0 -1 0"/><limit lower="-3" upper="3" effort="9" velocity="2"/></joint>
  <link name="l3"/>
  <joint name="w1" type="revolute"><parent link="l3"/><child link="l4"/>
    <origin xyz="0 0 0.39225" rpy="0 1.5707963267948966 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="2"/></joint>
  <link name="l4"/>
  <joint name="w2" type="revolute"><parent link="l4"/><child link="l5"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="9" velocity="2"/></joint>
  <link name="l5"/>
  <joint name="w3" type="continuous"><parent link="l5"/><child link="l6"/>
    <origin xyz="0 0.1 0.09465"/><axis xyz="0 0.6 0.8"/></joint>
  <link name="l6"/>
  <joint name="end" type="fixed"><parent link="l6"/><child link="tool"/>
    <origin xyz="0.02 0.0823 0" rpy="0.2 0 1"/></joint>
  <link name="tool"/>
  <joint name="finger" type="prismatic"><parent link="tool"/><child link="f"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/></joint>
  <link name="f"/>
  <transmission name="t"><joint name="elbow"/></transmission>
</robot>\r
"""


def arm_of(data, tip="", base=""):
    chain = parse_urdf(data, "six.urdf", base=base, tip=tip)
    return chain, parse_arm(dump_strict(dict(arm_file_of(chain, name="six"))), "six")


def with_changes(table, entries):
    columns = {name: np.array(getattr(table, name)) for name in table.__dataclass_fields__}
    for name, change in entries.items():
        column, _, row = name.rpartition("_")
        columns[next(c for c in columns if c.startswith(f"{column}_"))][int(row) - 1] += change
    return DhTable(**columns)


CHANGES = {
    f"{kind}_{row}": size * (1 + 0.1 * row) * (-1) ** row
    for kind, size in (("theta_off", 0.02), ("a", 1e-3), ("alpha", 3e-3))
    for row in range(1, 7)
} | {"beta_2": 1e-3, "beta_3": -2e-3, "s_1": 2e-3, "s_4": -1e-3, "s_5": 1e-3, "s_6": 3e-3}


CHAIN, ARM = arm_of(URDF.encode())


def calibrated_text(table, *, text=URDF, file="six.urdf", arm=ARM, comment=()):
    chain = chain_of(data := text.encode(), file, arm)
    return with_calibration(data, file, chain, table, comment).decode()


def without_origins(text, joints):
    """The text without the origins of these joints and without the added comment."""
    text = re.sub(r"<!--\n  calibrated.*?-->\n", "", text, flags=re.DOTALL)
    for name in joints:
        block = re.search(rf'<joint name="{name}" type.*?</joint>', text, re.DOTALL)
        text = text.replace(block[0], re.sub(r"<origin[^>]*/>", "", block[0]))
    return text


@pytest.mark.parametrize("tip", ["tool", "l6"])
@pytest.mark.parametrize("base", ["world", "l0"])
def test_tip_agrees_with_pinocchio_to_a_nanometre(tip, base):
    chain, arm = arm_of(URDF.encode(), tip, base)
    missing = entries_without_origin(chain)
    assert missing == (() if tip == "tool" else ("s_6", "a_6", "alpha_6", "beta_6"))
    table = with_changes(arm.table, {k: v for k, v in CHANGES.items() if k not in missing})
    assert tip_error(calibrated_text(table, arm=arm).encode(), chain, table) < 1e-9
    assert tip_error(URDF.encode(), chain, table) > 5e-3


@pytest.mark.parametrize(
    ("changes", "joints"),
    [
        (CHANGES, {"pan", "lift", "elbow", "w1", "w2", "w3", "end"}),
        # The elbow turns; the lift's angle was rounded and is written in full.
        ({"theta_off_3": 0.01}, {"elbow", "lift"}),
    ],
)
def test_only_origins_of_calibrated_joints_change(changes, joints):
    comment = ["calibrated by somebody", "a -- b"]
    text = calibrated_text(with_changes(ARM.table, changes), comment=comment)
    assert without_origins(text, joints) == without_origins(URDF, joints)
    assert text.index("calibrated by somebody") < text.index("<robot")
    assert "a - - b" in text
    if changes is not CHANGES:
        assert "1.5707963267948966" in text.split('name="lift"')[1].split("</joint>")[0]


def test_file_of_another_arm_is_refused():
    longer = with_changes(ARM.table, {"a_2": 0.3})
    with pytest.raises(ConfigError, match="its a_2 differs from six's 6 times more"):
        calibrated_text(longer, arm=replace(ARM, table=longer))
    renamed = replace(ARM, joints=(replace(ARM.joints[0], name="elbow"), *ARM.joints[1:]))
    with pytest.raises(ConfigError, match="4 revolute joints from l2b to l6; six has 6"):
        calibrated_text(ARM.table, arm=renamed)


def test_other_joint_names_select_the_matching_tip():
    tool = """<joint name="mount" type="fixed"><parent link="tool"/><child link="hand"/>
      <origin xyz="0 0 0.1" rpy="0.9 0 0.8"/></joint><link name="hand"/></robot>"""
    text = URDF.replace("</robot>", tool)
    chain, arm = arm_of(text.encode(), tip="tool", base="l0")
    joints = tuple(replace(j, name=f"joint {k}") for k, j in enumerate(arm.joints))
    table = with_changes(arm.table, CHANGES)
    by_names = calibrated_text(table, text=text, arm=arm)
    assert calibrated_text(table, text=text, arm=replace(arm, joints=joints)) == by_names
    assert tip_error(by_names.encode(), chain, table) < 1e-9


def test_xacro_without_literal_numbers_is_refused():
    text = URDF.replace('xyz="0 0 0.39225"', 'xyz="0 0 ${r}"')
    with pytest.raises(ConfigError, match="expand it with xacro first"):
        calibrated_text(ARM.table, text=text, file="six.urdf.xacro")


UR_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
UR_ORIGINS = {
    "shoulder": "0 0 0.1625 -0 0 0.002",
    "upper_arm": "0 0 0 1.570796327 0 -0.0",
    "forearm": "-0.425 0 0 1e-05 0 0",
    "wrist_1": "-0.3922 0 0.1333 0 0 -0",
    "wrist_2": "0 -0.0997 -2.044881182297852e-11 1.570796327 0 -0",
    "wrist_3": "0 0.0996 -2.042830148012698e-11 1.570796326589793 3.141592653589793 3.141592653589793",
}
UR_LINES = ["# maker's", "kinematics:"]
for _name, _numbers in UR_ORIGINS.items():
    UR_LINES.append(f"  {_name}:")
    UR_LINES += [f"    {k}: {v}" for k, v in zip(UR_KEYS, _numbers.split(), strict=True)]
UR_KINEMATICS = "\n".join([*UR_LINES, "  hash: calib_1\n"])


def ur_as_urdf(text):
    """A UR kinematics file as a URDF, by an independent reader."""
    links, joints, parent = yaml.safe_load(text)["kinematics"], [], "base"
    for name in UR_ORIGINS:
        xyz, rpy = (words([links[name][k] for k in keys]) for keys in (UR_KEYS[:3], UR_KEYS[3:]))
        joints.append(joint(name, parent, name, xyz, rpy, "0 0 1"))
        parent = name
    return robot(*joints).encode()


def test_ur_kinematics_file_gets_the_same_arm():
    chain, arm = arm_of(ur_as_urdf(UR_KINEMATICS))
    assert arm.hayati_rows == (2, 3)
    table = with_changes(
        arm.table, {k: v for k, v in CHANGES.items() if k not in ("a_6", "alpha_6", "s_6")}
    )
    calibrated = calibrated_text(
        table, text=UR_KINEMATICS, file="default_kinematics.yaml", arm=arm, comment=["by us"]
    )
    assert tip_error(ur_as_urdf(calibrated), chain, table) < 1e-9
    assert calibrated.startswith("# by us\n# maker's\n")
    without_numbers = [re.sub(r": [-+.\de]+$", "", line) for line in calibrated.splitlines()[1:]]
    assert without_numbers == [
        re.sub(r": [-+.\de]+$", "", line) for line in UR_KINEMATICS.splitlines()
    ]


@pytest.mark.parametrize("head", ["# Größe: é\n", "\ufeff", "\ufeff# é\r\n# a\u2028b\n"])
def test_ur_kinematics_file_keeps_its_other_text(head):
    _, arm = arm_of(ur_as_urdf(UR_KINEMATICS))
    table = with_changes(arm.table, {"theta_off_2": 0.01, "a_2": 0.001})
    reference, with_head = (
        calibrated_text(table, text=text, file="k.yaml", arm=arm, comment=["by us"])
        for text in (UR_KINEMATICS, head + UR_KINEMATICS)
    )
    mark = "\ufeff" if head.startswith("\ufeff") else ""
    assert with_head == mark + "# by us\n" + head.removeprefix(mark) + reference.removeprefix(
        "# by us\n"
    )


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", "shoulder has no z; write x, y, z, roll, pitch, yaw below"),
        ('    z: "0.1625"\n', "shoulder has no z"),
        ("    z: .nan\n", "'0 0 .nan'; write 3 numbers"),
    ],
)
def test_incomplete_ur_kinematics_file_is_refused(line, words):
    _, arm = arm_of(ur_as_urdf(UR_KINEMATICS))
    with pytest.raises(ConfigError, match=words):
        calibrated_text(
            arm.table, text=UR_KINEMATICS.replace("    z: 0.1625\n", line), file="k.yaml", arm=arm
        )


def test_only_the_effective_of_two_origins_changes():
    origin = """<origin  rpy='0 0 0.5'  xyz='0 0 0.0892'/>"""
    two_origins = URDF.replace(origin, origin + "<origin xyz='7 7 7'/>")
    table = with_changes(ARM.table, {"theta_off_1": 0.1})
    with_two_origins = calibrated_text(table, text=two_origins)
    assert with_two_origins.replace("<origin xyz='7 7 7'/>", "") == calibrated_text(table) != URDF

"""Joint logs: columns by name or number, and one problem for each mistake."""

import numpy as np
import pytest

from operator_app.config.errors import ConfigError
from operator_app.config.joint_log import load_joint_log
from operator_app.config.recording import load_timed_log


@pytest.mark.parametrize(
    ("header", "selected", "columns"),
    [
        ("t,q2,q1,q3", "", (2, 1, 3)),
        ("joint_0,joint_1,joint_2,joint_1_speed", "", (0, 1, 2)),
        ("q1,q2,q3,Q1", "", (0, 1, 2)),
        ("t,Joint1,joint2,JOINT3", "", (1, 2, 3)),
        ("t,q3,q2,q1,i8", "", (3, 2, 1)),
        ("q3,q2,q1", "", (2, 1, 0)),
        ("a,b,c", "", (0, 1, 2)),
        ("elbow,shoulder,base", "", (2, 1, 0)),
        ("elbow,base,q1,shoulder,q2,q3", "", (1, 3, 0)),
        *(("t q1 q2 speed q3", selected, (1, 2, 4)) for selected in ("2-3,5", "2,3,5", "q1,q2,q3")),
        ("t q1 q2 speed q3", "q3,q1,q2", (4, 1, 2)),
    ],
)
def test_joint_columns_are_recognised_or_selected(tmp_path, header, selected, columns):
    log, separator = tmp_path / "log.csv", "," if "," in header else " "
    rows = ((k + 10 * n for n in range(len(header.split(separator)))) for k in (0, 1))
    lines = ["# a comment", header, *(separator.join(map(str, row)) for row in rows)]
    log.write_text("\n".join(lines))
    arm = ("base", "shoulder", "elbow")
    options = {"columns": selected} if selected else {}
    poses = load_joint_log(log, joint_count=3, unit="deg", joints=arm, **options).poses
    expected = [[10 * column + k for column in columns] for k in (0, 1)]
    np.testing.assert_allclose(np.rad2deg(poses.q_rad), expected)


def test_measured_endpoints_of_rows_are_kept(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(
        "t,q1,q2,q3,x_m,y_m,z_m,qw,qx,qy,qz\n"
        "0,10,20,30,1.5,-0.5,0.25,0.5,0.5,0.5,0.5\n"
        "1,11,21,31,1.6,-0.6,0.35,1,0,0,0\n"
    )
    for columns in ("", "2-4"):
        poses = load_joint_log(log, joint_count=3, unit="deg", columns=columns).poses
        np.testing.assert_allclose(np.rad2deg(poses.q_rad[1]), [11, 21, 31])
        np.testing.assert_array_equal(poses.endpoint[:, :3], [[1.5, -0.5, 0.25], [1.6, -0.6, 0.35]])
        turns = np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]) * 2.0 * np.pi / 3.0 / np.sqrt(3.0)
        np.testing.assert_allclose(poses.endpoint[:, 3:], turns, atol=1e-12)
    log.write_text("a,b,c,x_m,y_m,z_m\n10,20,30,1,2,3\n")
    poses = load_joint_log(log, joint_count=3, unit="deg").poses
    np.testing.assert_array_equal(poses.endpoint, [[1.0, 2.0, 3.0]])


@pytest.mark.parametrize(
    ("header", "cells", "message"),
    [
        ("x_m,y_m,z_m,qw,qx,qy", "1,2,3,1,0,0", "without qz"),
        ("x_m,y_m,z_m,qw,qx,qy,qz", "1,2,3,1,1,1,1", "log.csv:2: has a quaternion of length 2"),
        ("x_m,y_m,z_m", "1,2000,3", "invalid y_m: 2000 m"),
        ("x_m,y_m,z_m", "1,,3", "y_m"),
        ("x_m,y_m,z_m,y_m", "1,2,3,4", "more than one column y_m"),
        ("x_mm,y_mm,tcp_Z", "1,2,3", "no columns x_m, y_m, z_m; write x_mm, y_mm, tcp_Z in metres"),
    ],
)
def test_invalid_endpoints_of_rows_are_refused(tmp_path, header, cells, message):
    log = tmp_path / "log.csv"
    log.write_text(f"q1,q2,q3,{header}\n10,20,30,{cells}\n")
    with pytest.raises(ConfigError, match=message):
        load_joint_log(log, joint_count=3, unit="deg", instrument=True)


def test_header_states_the_unit_unless_columns_and_unit_overrule_it(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("t,q1_rad,q2_rad\n0,1,2\n1,1.5,2.5\n")
    for columns, unit in (("", None), ("q1_rad,q2_rad", None), ("2-3", "deg")):
        poses = load_joint_log(log, joint_count=2, columns=columns, unit=unit).poses
        timed = load_timed_log(log, time="t", joints=("a", "b"), columns=columns, unit=unit)
        expected = np.multiply([[1.0, 2.0], [1.5, 2.5]], np.pi / 180.0 if unit else 1.0)
        assert poses.q_rad.tolist() == timed.q_rad.tolist() == expected.tolist()


@pytest.mark.parametrize("selected", ["", "base,shoulder,elbow"])
def test_a_joint_named_by_two_columns_is_refused(tmp_path, selected):
    log = tmp_path / "log.csv"
    log.write_text("base,shoulder,elbow,base\n10,20,30,40\n")
    joints = ("base", "shoulder", "elbow")
    with pytest.raises(ConfigError, match=r"2 columns 'base'|4 columns"):
        load_joint_log(log, joint_count=3, unit="deg", joints=joints, columns=selected)


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("0.1,0.2,0.3\n" * 6, {}),
        ("1,2,3,4\n", {"unit": "deg"}),
        ("t,a,b,c\n1,2,3,4\n", {"unit": "deg"}),
        ("1,2\n", {"unit": "deg"}),
        ("1,2,3\n4,x,6\n", {"unit": "deg"}),
        ("1,2,3\n4,5\n", {"unit": "deg"}),
        ("1,2,900\n", {"unit": "rad"}),
        ("1,200,900\n" * 9, {"unit": "rad"}),
        ("t,a,b,c,p\n1,2,3,4,x\n", {"unit": "deg", "placement": "p"}),
        ("1,2,3\n", {"unit": "deg", "columns": "1-4"}),
        ("1,2,3\n", {"unit": "deg", "columns": "1,1,2"}),
        ("1,2,3\n", {"unit": "deg", "columns": "q1"}),
        ("a,b,c,p\n1,2,3,4\n", {"unit": "deg", "columns": "2-4", "placement": "p"}),
        ("theta1_deg,theta2_deg,theta3_deg\n1,2,3\n", {"unit": "rad"}),
        ("# nothing\n", {}),
        ("a,1,2,3\n", {"unit": "deg", "placement": "hole"}),
        ("a,1,2,3\n", {"unit": "deg", "placement": "5"}),
        ("p,a,b,c\n1,1,2,3\n,4,5,6\n", {"unit": "deg", "placement": "p"}),
        ("p,a,b,c\n1,1,2,3\n", {"unit": "deg"}),
        ("1,2,nan\n", {"unit": "deg"}),
        ("q1,q2,q3,v1,v2,v3\n1,1,1,1,1,1\n", {}),
        ("time,base,shoulder,elbow,extra\n0,1,2,3,4\n", {}),
        ("a,b\n1,2,3,4\n", {"unit": "deg"}),
        ("q1,q2,q3,Q1,Q2,Q3\n0,10,20,30,40,50\n", {"unit": "deg"}),
        ("t,q1,q2,q4\n0,10,20,30\n", {"unit": "deg"}),
        pytest.param(f"q1,q2,q3,q{'9' * 5000}\n0,1,2,3\n", {}, id="thousands of digits"),
        ("10.5;20.5;30.5\n", {"unit": "deg"}),
        ("# by a spreadsheet\nq1;q2;q3\n10;20;30\n", {"unit": "deg"}),
        ("10,5;20,5;-30,5\n", {"unit": "deg"}),
        ("10,5 20,5 -30,5\n", {"unit": "deg"}),
        ("q1 q2 q3\n10,5\t20,5\t-30,5\n", {"unit": "deg"}),
        ("q1_rad,q2_rad,q3_rad\n1,2,3\n", {"unit": "deg"}),
        ("q1_rad,q2_rad,q3_deg\n1,2,3\n", {}),
        ("q1_deg,q2_deg,q3_deg\n" + "1,2,3\n" * 5, {}),
        ("1,2,3,4\n2,2,3,4\n", {"unit": "deg"}),
    ],
)
def test_invalid_log_is_refused_with_place_and_remedy(tmp_path, text, options, approve):
    file = tmp_path / "log.csv"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_joint_log(file, joint_count=3, **options)
    approve(str(caught.value).replace("9" * 5000, "9..."))

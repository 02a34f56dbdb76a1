"""Columns of a joint log: joints recognised by their names or numbers."""

import numpy as np
import pytest

from operator_app.config.errors import ConfigError
from operator_app.config.joint_log import load_joint_log


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        ("t,q2,q1,q3", (2, 1, 3)),
        ("joint_0,joint_1,joint_2,joint_1_speed", (0, 1, 2)),
        ("q1,q2,q3,Q1", (0, 1, 2)),
        ("t,Joint1,joint2,JOINT3", (1, 2, 3)),
        ("t,q3,q2,q1,i8", (3, 2, 1)),
        ("q3,q2,q1", (2, 1, 0)),
        ("a,b,c", (0, 1, 2)),
        ("elbow,shoulder,base", (2, 1, 0)),
        ("elbow,base,q1,shoulder,q2,q3", (1, 3, 0)),
        ("q1,q2,q3,Q1,Q2,Q3", None),
        ("t,q1,q2,q4", None),
        pytest.param(f"q1,q2,q3,q{'9' * 5000}", None, id="thousands of digits"),
    ],
)
def test_joint_columns_are_recognised_by_name_or_number(tmp_path, header, columns):
    log = tmp_path / "log.csv"
    cells = [str(10 * k) for k in range(len(header.split(",")))]
    log.write_text(f"{header}\n{','.join(cells)}\n")
    if columns is None:
        with pytest.raises(ConfigError, match="for an arm of 3 joints"):
            load_joint_log(log, joint_count=3, unit="deg")
    else:
        arm = ("base", "shoulder", "elbow")
        poses = load_joint_log(log, joint_count=3, unit="deg", joints=arm).poses
        np.testing.assert_allclose(np.rad2deg(poses.q_rad[0]), [10 * k for k in columns])


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
        ("x_m,y_m,z_m,qw,qx,qy,qz", "1,2,3,1,1,1,1", "quaternion of length 2"),
        ("x_m,y_m,z_m", "1,2000,3", "has y_m of 2000"),
        ("x_m,y_m,z_m", "1,,3", "y_m"),
    ],
)
def test_invalid_endpoints_of_rows_are_refused(tmp_path, header, cells, message):
    log = tmp_path / "log.csv"
    log.write_text(f"q1,q2,q3,{header}\n10,20,30,{cells}\n")
    with pytest.raises(ConfigError, match=message):
        load_joint_log(log, joint_count=3, unit="deg")


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("10.5;20.5;30.5\n", 1, "semicolons"),
        ("# by a spreadsheet\nq1;q2;q3\n10;20;30\n", 2, "semicolons"),
        ("10,5;20,5;-30,5\n", 1, "decimal commas"),
        ("10,5 20,5 -30,5\n", 1, "decimal commas"),
        ("q1 q2 q3\n10,5\t20,5\t-30,5\n", 2, "decimal commas"),
    ],
)
def test_semicolons_and_decimal_commas_are_reported(tmp_path, text, line, message):
    log = tmp_path / "log.csv"
    log.write_text(text)
    with pytest.raises(ConfigError, match=message) as refused:
        load_joint_log(log, joint_count=3, unit="deg")
    (problem,) = refused.value.problems
    assert problem.line == line

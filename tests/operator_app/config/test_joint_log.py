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

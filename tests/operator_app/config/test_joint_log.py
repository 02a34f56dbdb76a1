"""Columns of a joint log: joints found by their names or numbers."""

import numpy as np
import pytest

from operator_app.config.errors import ConfigError
from operator_app.config.joint_log import load_joint_log


@pytest.mark.parametrize(
    ("header", "places"),
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
def test_joints_are_the_one_series_of_numbers(tmp_path, header, places):
    log = tmp_path / "log.csv"
    cells = [str(10 * k) for k in range(len(header.split(",")))]
    log.write_text(f"{header}\n{','.join(cells)}\n")
    if places is None:
        with pytest.raises(ConfigError, match="for an arm of 3 joints"):
            load_joint_log(log, joint_count=3, unit="deg")
    else:
        arm = ("base", "shoulder", "elbow")
        read = load_joint_log(log, joint_count=3, unit="deg", joints=arm).poses
        np.testing.assert_allclose(np.rad2deg(read.q_rad[0]), [10 * k for k in places])


@pytest.mark.parametrize(
    ("text", "line", "fault"),
    [
        ("10.5;20.5;30.5\n", 1, "semicolons"),
        ("# by a spreadsheet\nq1;q2;q3\n10;20;30\n", 2, "semicolons"),
        ("10,5;20,5;-30,5\n", 1, "decimal commas"),
        ("10,5 20,5 -30,5\n", 1, "decimal commas"),
        ("q1 q2 q3\n10,5\t20,5\t-30,5\n", 2, "decimal commas"),
    ],
)
def test_the_marks_of_another_country_are_named(tmp_path, text, line, fault):
    log = tmp_path / "log.csv"
    log.write_text(text)
    with pytest.raises(ConfigError, match=fault) as refused:
        load_joint_log(log, joint_count=3, unit="deg")
    (problem,) = refused.value.problems
    assert problem.line == line

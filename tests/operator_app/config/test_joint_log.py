"""Columns of a joint log: joints found by their numbers."""

import pytest

from operator_app.config.joint_log import numbered_series


@pytest.mark.parametrize(
    ("names", "places"),
    [
        (["t", "q2", "q1", "q3"], (2, 1, 3)),
        (["joint_0", "joint_1", "joint_2", "joint_1_speed"], (0, 1, 2)),
        (["q1", "q2", "q3", "Q1"], (0, 1, 2)),
        (["Joint1", "joint2", "JOINT3"], (0, 1, 2)),
        (["q1", "q2", "q3", "Q1", "Q2", "Q3"], ()),
        (["q1", "q2", "q4"], ()),
    ],
)
def test_joints_are_the_one_series_of_numbers(names, places):
    assert numbered_series(names, 3) == places

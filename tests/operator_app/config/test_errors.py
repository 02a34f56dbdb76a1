"""Complaints: one line each, all of them, in the order of the file."""

import pytest

from operator_app.config.errors import ConfigError, Problem
from operator_app.config.poses_file import parse_poses


def test_a_problem_is_file_line_key_what_and_remedy():
    problem = Problem(file="a.yaml", line=3, column=7, key="x.y", text="is wrong", remedy="mend it")
    assert str(problem) == "a.yaml:3: x.y: is wrong; mend it"
    assert str(Problem(file="a.yaml", text="is empty")) == "a.yaml: is empty"
    asked = Problem(file="p.csv", text="a column called theta2?", remedy="add its unit")
    assert str(asked) == "p.csv: a column called theta2? add its unit"


def test_all_problems_are_listed_in_file_order():
    error = ConfigError(
        Problem(file="a", line=line, column=column, text=f"{line}.{column}")
        for line, column in ((9, 1), (2, 5), (2, 1))
    )
    assert str(error).splitlines() == ["a:2: 2.1", "a:2: 2.5", "a:9: 9.1"]


def test_an_error_without_a_problem_is_a_wrong_call():
    with pytest.raises(ValueError, match="at least one problem"):
        ConfigError(())


def test_nothing_from_a_file_reaches_the_terminal_as_control_characters():
    data = b'placement,pose,theta1_deg,"\x1b[2J\nred"\n1,1,2,3\n'
    with pytest.raises(ConfigError) as caught:
        parse_poses(data, "p.csv")
    assert str(caught.value).isprintable()
    assert "\\x1b[2J\\nred" in str(caught.value)

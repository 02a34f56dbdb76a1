"""Problems of a file: one line each, all of them, in file order."""

import pytest

from operator_app.config.errors import ConfigError, Problem
from operator_app.config.poses_file import parse_poses


def test_problem_text_has_file_line_key_fact_and_remedy():
    problem = Problem(file="a.yaml", line=3, column=7, key="x.y", text="is wrong", remedy="mend it")
    assert str(problem) == "a.yaml:3: x.y: is wrong; mend it"
    assert str(Problem(file="a.yaml", text="is empty")) == "a.yaml: is empty"
    question = Problem(file="p.csv", text="a column called theta2?", remedy="add its unit")
    assert str(question) == "p.csv: a column called theta2? add its unit"


def test_problems_are_sorted_by_line_and_column():
    error = ConfigError(
        Problem(file="a", line=line, column=column, text=f"{line}.{column}")
        for line, column in ((9, 1), (2, 5), (2, 1))
    )
    assert str(error).splitlines() == ["a:2: 2.1", "a:2: 2.5", "a:9: 9.1"]
    with pytest.raises(ValueError, match="at least one problem"):
        ConfigError(())


def test_control_characters_of_a_file_are_escaped():
    data = b'placement,pose,theta1_deg,"\x1b[2J\nred"\n1,1,2,3\n'
    with pytest.raises(ConfigError) as caught:
        parse_poses(data, "p.csv")
    assert str(caught.value).isprintable()
    assert "\\x1b[2J\\nred" in str(caught.value)

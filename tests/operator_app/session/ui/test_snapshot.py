"""What is published is typed: a misspelt field, or a wrong value, is refused before anything runs."""

from pathlib import Path

import pytest
from mypy import api

ROOT = Path(__file__).parents[4]
SNIPPET = """
from dataclasses import replace

from operator_app.session.ui.runner import Runner
from operator_app.session.ui.snapshot import Publisher


def publish(runner: Runner, publisher: Publisher) -> None:
    runner.publish(lambda s: replace(s, stop_tested=True))
    publisher.publish(lambda s: replace(s, stop_tested=True))
    runner.publish(lambda s: replace(s, stop_testd=True))
    publisher.publish(lambda s: replace(s, stop_testd=True))
    runner.publish(lambda s: replace(s, estimator=("paper",)))
    publisher.publish(lambda s: replace(s, estimator=("paper",)))
"""


@pytest.mark.campaign
def test_a_misspelt_or_mistyped_field_is_a_type_error_and_a_right_one_is_not(tmp_path) -> None:
    file = tmp_path / "snippet.py"
    file.write_text(SNIPPET, "utf-8")
    # The cache of the type check itself, where there is one: all of the project read anew takes long.
    options = [
        "--strict",
        "--config-file",
        ROOT / "pyproject.toml",
        "--cache-dir",
        ROOT / ".mypy_cache",
    ]
    report, problems, _ = api.run([str(word) for word in (*options, file)])
    assert not problems
    errors = [row for row in report.splitlines() if "snippet.py" in row and " error: " in row]
    assert [int(row.split(":")[1]) for row in errors] == [11, 12, 13, 14]
    assert all('Unexpected keyword argument "stop_testd"' in row for row in errors[:2])
    assert all('"estimator"' in row and 'expected "str"' in row for row in errors[2:])

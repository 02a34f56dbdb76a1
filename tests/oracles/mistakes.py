"""Mistakes in valid files, and the reported problems."""

from collections.abc import Callable

import pytest

from operator_app.config.errors import ConfigError, Problem


def parse_problems(parse: Callable[[str], object], text: str) -> tuple[Problem, ...]:
    with pytest.raises(ConfigError) as caught:
        parse(text)
    return caught.value.problems


def single_problem(parse: Callable[[str], object], good: str, old: str, new: str) -> Problem:
    """The only problem of a valid text whose first `old` is replaced by `new`."""
    assert old in good
    problems = parse_problems(parse, good.replace(old, new, 1))
    assert len(problems) == 1, problems
    assert problems[0].line is not None
    return problems[0]


def is_within_replacement(problem: Problem, good: str, old: str, new: str) -> bool:
    """Whether a problem's line is within the replacement of the first `old`."""
    first = good[: good.index(old)].count("\n") + 1
    return problem.line is not None and first <= problem.line <= first + new.count("\n")


def named(bad: list[tuple[str, str, str]]) -> list[str]:
    """Ids of cases (old text, new text, key of the problem)."""
    return [f"{key}: {new.strip()}" for _, new, key in bad]

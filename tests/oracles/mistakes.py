"""Mistakes in good files, and the problems that a reader finds in them."""

from collections.abc import Callable

import pytest

from operator_app.config.errors import ConfigError, Problem


def problems_of(parse: Callable[[str], object], text: str) -> tuple[Problem, ...]:
    """Return all problems for which a text is refused."""
    with pytest.raises(ConfigError) as caught:
        parse(text)
    return caught.value.problems


def one_mistake(parse: Callable[[str], object], good: str, old: str, new: str) -> Problem:
    """Return the only problem of a good text in which the first `old` stands as `new`."""
    assert old in good
    problems = problems_of(parse, good.replace(old, new, 1))
    assert len(problems) == 1, problems
    assert problems[0].line is not None
    return problems[0]


def is_at(problem: Problem, good: str, old: str, new: str) -> bool:
    """Whether a problem's line is one of those that were written for the first `old`."""
    first = good[: good.index(old)].count("\n") + 1
    return problem.line is not None and first <= problem.line <= first + new.count("\n")


def named(bad: list[tuple[str, str, str]]) -> list[str]:
    """Return names of such cases (old text, new text, key of the problem) for pytest."""
    return [f"{key}: {new.strip()}" for _, new, key in bad]

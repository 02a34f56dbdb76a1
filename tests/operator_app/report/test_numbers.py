"""Numbers as words: places, signs, powers, and nothing that is not a number."""

from __future__ import annotations

import math

import pytest

from operator_app.report.numbers import fixed, names, places_to_show, plural, significant


@pytest.mark.parametrize(
    ("value", "places", "signed", "words"),
    [
        (1.005, 1, False, "1.0"),
        (-2.5, 1, False, "\u22122.5"),
        (2.5, 1, True, "+2.5"),
        (-0.004, 2, True, "0.00"),
        (0.0, 2, True, "0.00"),
        (math.nan, 2, False, "n/a"),
        (math.inf, 2, False, "n/a"),
    ],
)
def test_fixed(value: float, places: int, signed: bool, words: str) -> None:
    assert fixed(value, places, signed=signed) == words


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.0, "0"),
        (15.797, "15.8"),
        (0.75771, "0.758"),
        (-34.44, "\u221234.4"),
        (999.6, "1000"),
        (99999.0, "1.00·10⁵"),
        (338420.81, "3.38·10⁵"),
        (6.7e-6, "6.70·10⁻⁶"),
        (0.00034, "0.000340"),
        (math.inf, "infinite"),
        (math.nan, "n/a"),
    ],
)
def test_significant(value: float, words: str) -> None:
    assert significant(value) == words


def test_places_show_two_digits_of_the_finest() -> None:
    assert places_to_show([0.0007, 0.02]) == 5
    assert places_to_show([3.0]) == 1
    assert places_to_show([]) == 1
    assert places_to_show([0.0, math.nan], least=3) == 3
    assert places_to_show([1e-30]) == 9


def test_words() -> None:
    assert plural(1, "pose") == "1 pose"
    assert plural(2, "pose") == "2 poses"
    assert names([1]) == "1"
    assert names([1, 2, 3]) == "1, 2 and 3"
    assert names([]) == ""

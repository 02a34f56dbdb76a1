"""Numbers as text: decimal places, signs, powers of ten, not-a-number."""

import math

import pytest

from operator_app.units import (
    fixed,
    places_needed,
    places_to_show,
    significant,
    typeset,
)


@pytest.mark.parametrize(
    ("value", "places", "signed", "text"),
    [
        (1.005, 1, False, "1.0"),
        (-2.5, 1, False, "-2.5"),
        (2.5, 1, True, "+2.5"),
        (-0.004, 2, True, "0.00"),
        (0.0, 2, True, "0.00"),
        (math.nan, 2, False, "n/a"),
        (math.inf, 2, False, "n/a"),
    ],
)
def test_fixed_has_given_decimal_places(value, places, signed, text):
    assert fixed(value, places, signed=signed) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (15.797, "15.8"),
        (0.75771, "0.758"),
        (-34.44, "-34.4"),
        (999.6, "1000"),
        (99999.0, "1.00e+05"),
        (338420.81, "3.38e+05"),
        (6.7e-6, "6.70e-06"),
        (0.00034, "0.000340"),
        (math.inf, "infinite"),
        (math.nan, "n/a"),
    ],
)
def test_significant_has_three_digits(value, text):
    assert significant(value) == text


def test_places_to_show_give_two_digits_of_the_smallest():
    assert places_to_show([0.0007, 0.02]) == 5
    assert places_to_show([3.0]) == 1
    assert places_to_show([]) == 1
    assert places_to_show([0.0, math.nan], least=3) == 3
    assert places_to_show([1e-30]) == 9


def test_places_needed_keep_all_digits():
    assert places_needed([10.0, 355.5, -0.25], least=1, most=6) == 2
    assert places_needed([100.0], least=1, most=6) == 1
    assert places_needed([1.0 / 3.0], least=1, most=6) == 6


@pytest.mark.parametrize(
    ("plain", "printed"),
    [
        ("-34.4", "\u221234.4"),
        ("-1 to 1", "\u22121 to 1"),
        ("3.38e+05 mm", "3.38·10⁵ mm"),
        ("< 1e-12", "< 1·10⁻¹²"),
        ("eqs. 10-13, SDA-0001, 2026-01-31", "eqs. 10-13, SDA-0001, 2026-01-31"),
    ],
)
def test_typeset_has_minus_signs_and_superscripts(plain, printed):
    assert typeset(plain) == printed

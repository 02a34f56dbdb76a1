"""Numbers as text; units and digits of displayed quantities, which no other module converts."""

import ast
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

import operator_app
from operator_app.units import (
    DATA_AGE,
    POSITION,
    READING_SD,
    SIGMA_ORI,
    SIGMA_POS,
    fixed,
    places_needed,
    places_to_show,
    significant,
    typeset,
)

PACKAGES = ("calibration", "tui", "headless", "commands", "report", "session")
ROOT = Path(operator_app.__file__).parent
FILES_WITH_UNITS_IN_KEYS = {
    ROOT / "session" / "store" / "parameters_document.py",
    ROOT / "report" / "calibration_json.py",
    ROOT / "report" / "uncertainty_tables.py",
    ROOT / "report" / "results" / "history.py",
    ROOT / "report" / "results" / "recording.py",
    ROOT / "commands" / "import_poses.py",
    ROOT / "report" / "results" / "plan.py",
    ROOT / "report" / "exports.py",
    ROOT / "session" / "workflow" / "importing.py",
}
"""Documents, JSON and options, whose key names state their units."""
CONVERSIONS = {"math.degrees", "np.degrees", "np.rad2deg"}


def conversions(tree: ast.AST) -> Iterator[str]:
    """Conversions from SI to display units: a call to degrees, a factor of 1e3 or 1e6."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and ast.unparse(node) in CONVERSIONS:
            yield f"line {node.lineno}: {ast.unparse(node)}"
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
            factors = [s.value for s in (node.left, node.right) if isinstance(s, ast.Constant)]
            if any(value in (1e3, 1e6) for value in factors):
                yield f"line {node.lineno}: times {factors}"


def test_only_units_module_converts_to_display_units():
    files = [p for room in PACKAGES for p in sorted((ROOT / room).rglob("*.py"))]
    assert len(files) > 60
    assert all(p.is_file() for p in FILES_WITH_UNITS_IN_KEYS)
    conversions_by_file = {
        str(p.relative_to(ROOT)): lines
        for p in files
        if p not in FILES_WITH_UNITS_IN_KEYS
        and (lines := list(conversions(ast.parse(p.read_text()))))
    }
    assert conversions_by_file == {}
    # The scan finds conversions.
    assert list(conversions(ast.parse("f'{math.degrees(x):.3f} deg'")))
    assert list(conversions(ast.parse("f'{1e3 * x:.3f} mm'")))
    assert not list(conversions(ast.parse("2.0 * x")))


@pytest.mark.parametrize(
    ("kind", "value", "text"),
    [
        (POSITION, math.pi / 6.0, "+30.000 deg"),
        (READING_SD, 1e-5, "0.0006 deg"),
        (SIGMA_POS, 0.00063381, "0.6338 mm"),
        (SIGMA_ORI, 0.0081984, "8.198 mrad"),
        (DATA_AGE, 0.0124, "12 ms"),
    ],
)
def test_kind_formats_its_values(kind, value, text):
    assert kind(value).with_unit == text
    assert kind(value, role="warn", key=("a",)).key == ("a",)
    assert kind(None).shown == "n/a"


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


def test_places_give_two_digits_of_the_smallest_or_all_digits():
    assert places_to_show([0.0007, 0.02]) == 5
    assert places_to_show([3.0]) == 1
    assert places_to_show([]) == 1
    assert places_to_show([0.0, math.nan], least=3) == 3
    assert places_to_show([1e-30]) == 9
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

"""Displayed quantities have unit and digits from one list; no other module converts."""

import ast
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

import operator_app
from operator_app import units
from operator_app.units import DATA_AGE, POSITION, READING_SD, SIGMA_ORI, SIGMA_POS, Kind

PACKAGES = ("calibration", "tui", "headless", "commands", "report", "session")
ROOT = Path(operator_app.__file__).parent
FILES_WITH_UNITS_IN_KEYS = {
    ROOT / "session" / "store" / "parameters_document.py",
    ROOT / "report" / "json_schema.py",
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


def test_scan_finds_conversions():
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


def test_every_kind_has_a_finite_unit():
    kinds = [k for k in vars(units).values() if isinstance(k, Kind)]
    assert len(kinds) > 15
    assert all(math.isfinite(k.quantity.per_si) for k in kinds)

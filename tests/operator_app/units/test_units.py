"""What is shown in several places has its unit and digits from one list; nobody beside it converts."""

import ast
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

import operator_app
from operator_app import units
from operator_app.units import DATA_AGE, POSITION, READING_SD, SIGMA_ORI, SIGMA_POS, Kind

ROOMS = ("calibration", "tui", "headless", "commands", "report", "session")
ROOT = Path(operator_app.__file__).parent
KEYED = {
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
"""Documents, JSON and options: their keys and names say their units, and are a contract."""
CONVERSIONS = {"math.degrees", "np.degrees", "np.rad2deg"}


def shows_itself(tree: ast.AST) -> Iterator[str]:
    """Places that turn SI into what people read: a call of degrees, a factor of a thousand."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and ast.unparse(node) in CONVERSIONS:
            yield f"line {node.lineno}: {ast.unparse(node)}"
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
            sides = [s.value for s in (node.left, node.right) if isinstance(s, ast.Constant)]
            if any(value in (1e3, 1e6) for value in sides):
                yield f"line {node.lineno}: times {sides}"


def test_no_face_and_no_command_converts_to_units_that_people_read():
    files = [p for room in ROOMS for p in sorted((ROOT / room).rglob("*.py"))]
    assert len(files) > 60
    assert all(p.is_file() for p in KEYED)
    found = {
        str(p.relative_to(ROOT)): said
        for p in files
        if p not in KEYED and (said := list(shows_itself(ast.parse(p.read_text()))))
    }
    assert found == {}


def test_the_scan_finds_a_conversion():
    assert list(shows_itself(ast.parse("f'{math.degrees(x):.3f} deg'")))
    assert list(shows_itself(ast.parse("f'{1e3 * x:.3f} mm'")))
    assert not list(shows_itself(ast.parse("2.0 * x")))


@pytest.mark.parametrize(
    ("kind", "value", "shown"),
    [
        (POSITION, math.pi / 6.0, "+30.000 deg"),
        (READING_SD, 1e-5, "0.0006 deg"),
        (SIGMA_POS, 0.00063381, "0.6338 mm"),
        (SIGMA_ORI, 0.0081984, "8.198 mrad"),
        (DATA_AGE, 0.0124, "12 ms"),
    ],
)
def test_a_kind_gives_figures_alike(kind, value, shown):
    assert kind(value).with_unit == shown
    assert kind(value, role="warn", key=("a",)).key == ("a",)
    assert kind(None).shown == "n/a"


def test_every_kind_is_of_a_quantity():
    kinds = [k for k in vars(units).values() if isinstance(k, Kind)]
    assert len(kinds) > 15
    assert all(math.isfinite(k.quantity.per_si) for k in kinds)

"""One idea, one name: class, module and constant names across the product, and words that are no names of the field."""

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("operator_app", "hardware", "fixtures", "solver")
NO_NAMES = {
    "anew", "astray", "belief", "believe", "believed", "deaf", "desk", "disbelieved", "flexure", "foreseen", "foretell",
    "foretold", "halving", "halvings", "judgement", "leftover", "parting", "perhaps", "rival", "rivals", "sameness",
    "soften", "softened", "stray", "told", "unreturned", "unsteady", "untold", "watchman",
}  # fmt: skip
"""Words without a meaning in metrology, robotics or CiA 301/402; each has a standard word."""

FACES = (
    "operator_app/api",
    "operator_app/commands",
    "operator_app/report/results",
    "operator_app/tui/steps",
)
"""Folders whose modules have the names of what they show or offer: `sarcal compare` shows `calibration.comparison`."""

NAMED_TWICE = {
    "errors": "of each package",
    "cross_validation": "calibration's, by the solver's of the same name",
    "error_model": "calibration's, by the solver's; config has what files state of it",
    "exploration": "planning's, by solver.design's",
    "parameters": "of the parameters file, and of the solver",
    "placements": "calibration's, by the solver's",
    "rvdt": "calibration's, by the solver's",
}
"""Module names of two modules, with the reason."""

CONSTANTS_TWICE = {
    "CHUNK", "CENTRES", "DEFLECTION_COLUMNS", "SAG_COLUMNS",  # sizes of the solver's own bases, each by one module
    "FREE", "NEAR_RAD", "SEEN", "TIMES", "TINY",  # limits of its iterations
    "MAX_ITERATIONS", "RANK_TOLERANCE", "STEP_TOLERANCE",  # likewise
}  # fmt: skip
"""Constants of two modules with two values, with the reason."""

EXCEPTIONS = {"test_a_drive_joint_goes_where_it_is_told_and_back"}
"""A test of the contract that other packages run: its name is public."""


@cache
def modules() -> list[tuple[Path, ast.Module]]:
    return [
        (path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8")))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
    ]


def identifiers(path: Path, module: ast.Module) -> set[str]:
    """Return every name that a module defines or uses, its own among them."""
    found = {path.stem}
    for node in ast.walk(module):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                found.add(name)
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                found.add(name)
            case ast.ClassDef(name=name) | ast.keyword(arg=str(name)):
                found.add(name)
    return found


def words(name: str) -> set[str]:
    """Return the words of a name in snake or camel case."""
    return set(re.findall(r"[a-z]+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()))


def test_a_class_name_is_defined_once():
    places = defaultdict(list)
    for path, module in modules():
        for node in module.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path))
    twice = {name: found for name, found in places.items() if len(found) > 1}
    assert not twice, twice


def test_a_module_name_stands_once():
    places = defaultdict(list)
    for path, _ in modules():
        if path.stem != "__init__" and not str(path).startswith(FACES):
            places[path.stem].append(str(path))
    twice = {name: found for name, found in places.items() if len(found) > 1}
    assert set(twice) == set(NAMED_TWICE), twice


def constants(module: ast.Module) -> dict[str, str]:
    """Return the values of the constants that a module defines for itself and others."""
    found = {}
    for node in module.body:
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                pairs = list(zip(names, values, strict=True))
            case ast.Assign(targets=[name], value=value) | ast.AnnAssign(target=name, value=value):
                pairs = [(name, value)]
            case _:
                continue
        for name, value in pairs:
            alias = isinstance(value, ast.Name) or "TypeVar" in ast.dump(value or node)
            if (
                isinstance(name, ast.Name)
                and re.fullmatch("[A-Z][A-Z0-9_]+", name.id)
                and not alias
            ):
                found[name.id] = ast.unparse(value or node)
    return found


def test_a_constant_has_one_meaning():
    values = defaultdict(lambda: defaultdict(list))
    for path, module in modules():
        for name, value in constants(module).items():
            values[name][value].append(str(path))
    twice = {name: dict(found) for name, found in values.items() if len(found) > 1}
    assert set(twice) == CONSTANTS_TWICE, {
        n: f for n, f in twice.items() if n not in CONSTANTS_TWICE
    }


def test_names_are_words_of_the_field():
    found = defaultdict(set)
    for path, module in modules():
        for name in identifiers(path, module):
            if words(name) & NO_NAMES:
                found[name].add(str(path))
    assert set(found) == EXCEPTIONS, {n: p for n, p in found.items() if n not in EXCEPTIONS}


def test_words_are_split_by_case_and_underscore():
    assert words("_AS_FORETOLD") == {"as", "foretold"}
    assert words("DriveAstray") == {"drive", "astray"}

"""Class, module and constant names are unique in the product, and contain no words from outside the field."""

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("operator_app", "hardware", "fixtures", "solver")
FORBIDDEN_WORDS = {
    "anew", "astray", "belief", "believe", "believed", "deaf", "desk", "disbelieved", "flexure", "foreseen", "foretell",
    "foretold", "halving", "halvings", "judgement", "leftover", "parting", "perhaps", "rival", "rivals", "sameness",
    "soften", "softened", "stray", "told", "unreturned", "unsteady", "untold", "watchman",
}  # fmt: skip
"""Words without a meaning in metrology, robotics or CiA 301/402; each has a standard word."""

INTERFACE_FOLDERS = (
    "operator_app/api",
    "operator_app/commands",
    "operator_app/report/results",
    "operator_app/tui/steps",
)
"""Folders whose modules are named like what they show: `sarcal compare` shows `calibration.comparison`."""

REPEATED_MODULES = {
    "errors": "of each package",
    "cross_validation": "calibration's, by the solver's of the same name",
    "error_model": "calibration's, by the solver's; config has what files state of it",
    "exploration": "planning's, by solver.design's",
    "placements": "calibration's, by the solver's",
    "rvdt": "calibration's, by the solver's",
}

REPEATED_CONSTANTS = {
    "CENTRES", "DEFLECTION_COLUMNS", "SAG_COLUMNS",  # sizes of the solver's own bases, each by one module
    "FREE", "NEAR_RAD", "SEEN", "TIMES", "TINY",  # limits of its iterations
    "MAX_ITERATIONS", "RANK_TOLERANCE", "STEP_TOLERANCE",  # likewise
}  # fmt: skip

EXCEPTIONS = {"test_a_drive_joint_goes_where_it_is_told_and_back"}
"""A public name: a test of the contract that other packages run."""


@cache
def modules() -> list[tuple[Path, ast.Module]]:
    return [
        (path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8")))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
    ]


def identifiers(path: Path, module: ast.Module) -> set[str]:
    """Return every name that a module defines or uses, and its own."""
    fields = ("id", "attr", "arg", "name")
    names = (getattr(node, field, None) for node in ast.walk(module) for field in fields)
    return {path.stem, *(name for name in names if isinstance(name, str))}


def words(name: str) -> set[str]:
    """Return the words of a name in snake or camel case."""
    return set(re.findall(r"[a-z]+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()))


def test_module_and_class_names_are_unique():
    module_paths, class_paths = defaultdict(list), defaultdict(list)
    for path, module in modules():
        if path.stem != "__init__" and not str(path).startswith(INTERFACE_FOLDERS):
            module_paths[path.stem].append(str(path))
        for node in module.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                class_paths[node.name].append(str(path))
    repeated = {name: paths for name, paths in module_paths.items() if len(paths) > 1}
    assert set(repeated) == set(REPEATED_MODULES), repeated
    repeated = {name: paths for name, paths in class_paths.items() if len(paths) > 1}
    assert not repeated, repeated


def constants(module: ast.Module) -> dict[str, str]:
    """Return the constants that a module defines, other than aliases and type variables, with their values."""
    constant_values = {}
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
            upper = isinstance(name, ast.Name) and re.fullmatch("[A-Z][A-Z0-9_]+", name.id)
            if upper and not alias:
                constant_values[name.id] = ast.unparse(value or node)
    return constant_values


def test_constants_with_one_name_have_one_value():
    values = defaultdict(lambda: defaultdict(list))
    for path, module in modules():
        for name, value in constants(module).items():
            values[name][value].append(str(path))
    repeated = {name: dict(paths) for name, paths in values.items() if len(paths) > 1}
    assert set(repeated) == REPEATED_CONSTANTS, repeated


def test_names_contain_no_forbidden_word():
    assert words("_AS_FORETOLD") == {"as", "foretold"}
    assert words("DriveAstray") == {"drive", "astray"}
    paths = defaultdict(set)
    for path, module in modules():
        for name in identifiers(path, module):
            if words(name) & FORBIDDEN_WORDS:
                paths[name].add(str(path))
    assert set(paths) == EXCEPTIONS, paths

"""From a strict YAML document to a checked model, complaining about everything at once. Knows no kind.

Wraps pydantic: its errors become `Problem`s with file, line and key, unknown keys get the key that
was probably meant, and a misspelt key does not also count as a missing one.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeVar, cast, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo
from pydantic_core import ErrorDetails

from operator_app.config.errors import ConfigError, Problem
from operator_app.config.quantities import length_doubt
from operator_app.config.schema_words import is_near_option, value_in_words, words_for
from operator_app.config.strict_yaml import load_strict
from operator_app.config.yaml_document import Path, YamlDocument

M = TypeVar("M", bound="StrictModel")

UNITS = {
    "m": "metres",
    "mm": "millimetres",
    "deg": "degrees",
    "rad": "radians",
    "mrad": "milliradians",
    "s": "seconds",
    "counts": "counts",
    "deg_per_s": "degrees per second",
    "rad_per_s": "radians per second",
    "nm": "newton metres",
    "n_per_m": "newtons per metre",
    "nm_per_rad": "newton metres per radian",
}
UNIT = re.compile(rf"(.+)_({'|'.join(sorted(UNITS, key=len, reverse=True))})")


class StrictModel(BaseModel):
    """Base of every model of a file: nothing unknown, nothing changed afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def report(info: ValidationInfo, path: Path, text: str, remedy: str = "") -> None:
    """Note a problem at `path` from inside a validator, without stopping the validation.

    For checks between fields: they can name several places, and pydantic's own exceptions cannot.
    """
    cast("list[tuple[Path, str, str]]", info.context).append((path, text, remedy))


def read_model(model: type[M], data: bytes, *, kind: str, file: str) -> M:
    """Read the bytes of a file of `kind` (``schema: sarcal/<kind>/1``) into `model`.

    Raises
    ------
    ConfigError
        With all that is wrong.
    """
    return check_model(model, load_strict(data, file), kind=kind)


def check_model(model: type[M], document: YamlDocument, *, kind: str) -> M:
    """Check a document that has been read; otherwise as `read_model`."""
    return _validate(model, document, [*document.problems, *_check_schema(document, kind)])


def read_by_kind(models: Mapping[str, type[M]], data: bytes, *, kind: str, file: str) -> M:
    """Read a file whose key ``kind`` says which model it follows; otherwise as `read_model`."""
    document = load_strict(data, file)
    problems = [*document.problems, *_check_schema(document, kind)]
    which = document.data.get("kind")
    if not isinstance(which, str) or which not in models:
        options = ", ".join(models)
        near = difflib.get_close_matches(str(which), list(models), n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        known = f"{value_in_words(which)} is no kind of {kind} known here"
        text = known if "kind" in document.data else "is missing"
        problems.append(document.problem(("kind",), text, f"{hint}one of: {options}"))
        raise ConfigError(problems)
    return _validate(models[which], document, problems)


def _validate(model: type[M], document: YamlDocument, problems: list[Problem]) -> M:
    body = {key: value for key, value in document.data.items() if key != "schema"}
    notes: list[tuple[Path, str, str]] = []
    checked: M | None = None
    try:
        checked = model.model_validate(body, context=notes)
    except ValidationError as error:
        problems += _problems(document, model, error.errors(include_url=False))
    problems += [document.problem(path, text, remedy) for path, text, remedy in notes]
    if problems or checked is None:
        raise ConfigError(problems)
    return checked


def _check_schema(document: YamlDocument, kind: str) -> Iterator[Problem]:
    wanted = f"sarcal/{kind}/1"
    line = f"the first line must be `schema: {wanted}`"
    if "schema" not in document.data:
        yield document.problem((), "has no schema", line)
        return
    found = document.data["schema"]
    if found != wanted:
        match = re.fullmatch(r"sarcal/([a-z]+)/(\d{1,9})", str(found))
        problem = document.problem(
            ("schema",), f"{found!r} is not a schema this program knows", line
        )
        if match is not None and match[1] != kind:
            problem = document.problem(
                ("schema",), f"this is a file of kind {match[1]}", f"kind {kind} is wanted: {line}"
            )
        elif match is not None:
            problem = document.problem(
                ("schema",),
                f"version {match[2]} of the {kind} file",
                "this program reads version 1",
            )
        # Every other complaint would only follow from this one.
        raise ConfigError((problem,))
    if next(iter(document.data)) != "schema":
        yield document.problem(("schema",), "is not the first key", line)


def _problems(
    document: YamlDocument, model: type[BaseModel], errors: Iterable[ErrorDetails]
) -> Iterator[Problem]:
    placed = _without_alternatives(document, [(_path(document, error), error) for error in errors])
    missing = {path for path, error in placed if error["type"] == "missing"}
    meant: set[Path] = set()
    for path, error in placed:
        if error["type"] != "extra_forbidden":
            continue
        text, remedy, instead = _unknown_key(document, model, path, missing - meant)
        if instead is not None:
            meant.add(instead)
        yield document.problem(path, text, remedy)
    for path, error in placed:
        if error["type"] == "extra_forbidden" or path in meant:
            continue
        if any(path[: len(bad)] == bad for bad in document.unreadable):
            continue
        yield document.problem(path, *words_for(error))


def _without_alternatives(
    document: YamlDocument, placed: list[tuple[Path, ErrorDetails]]
) -> list[tuple[Path, ErrorDetails]]:
    """Keep one complaint where a value may be a word or something else and is neither.

    Pydantic lists what is wrong with every alternative. The word is what was meant if it is nearly
    right, or if words are all that text could be.
    """
    kept = list(placed)
    for path, error in placed:
        if error["type"] != "literal_error":
            continue
        rest = [e for p, e in placed if p[: len(path)] == path and e is not error]
        value = document.at(path)
        numeric = any(e["type"].startswith(("float", "int")) for e in rest)
        word = isinstance(value, str) and (not numeric or is_near_option(error))
        dropped = rest if word else [error] if rest else []
        kept = [item for item in kept if not any(item[1] is e for e in dropped)]
    return kept


def _path(document: YamlDocument, error: ErrorDetails) -> Path:
    """Pydantic's location without the tags of unions, which are not in the file."""
    path: Path = ()
    loc = error["loc"]
    for depth, part in enumerate(loc):
        value = document.at(path)
        inside = (isinstance(value, dict) and part in value) or (
            isinstance(value, list) and isinstance(part, int) and part < len(value)
        )
        absent = error["type"] == "missing" and depth == len(loc) - 1
        if inside or absent:
            path = (*path, part)
    return path


def _unknown_key(
    document: YamlDocument, model: type[BaseModel], path: Path, missing: set[Path]
) -> tuple[str, str, Path | None]:
    """Text, remedy, and the missing key that was probably meant."""
    key, parent = str(path[-1]), path[:-1]
    known = _keys(document, model, parent)
    present = document.at(parent)
    open_keys = [k for k in known if k not in present]
    value = document.at(path)
    text = "unknown key"
    match = UNIT.fullmatch(key)
    for candidate in known:
        other = UNIT.fullmatch(candidate)
        if match is None or other is None or match[1] != other[1]:
            continue
        if match[2] == "m" and isinstance(value, int | float) and length_doubt(value):
            text += f" ({length_doubt(value)})"
        remedy = f"this file wants {UNITS[other[2]]}, not {UNITS[match[2]]}: write {candidate}"
        path_meant = (*parent, candidate)
        return text, remedy, path_meant if path_meant in missing else None
    stems = {c: UNIT.fullmatch(c) for c in open_keys}
    bare = [c for c, m in stems.items() if m is not None and m[1] == key]
    near = bare or difflib.get_close_matches(key, open_keys, n=1, cutoff=0.6)
    if near:
        path_meant = (*parent, near[0])
        return text, f"did you mean {near[0]}?", path_meant if path_meant in missing else None
    return text, f"known here: {', '.join(known)}" if known else "remove it", None


def _keys(document: YamlDocument, model: type[BaseModel], path: Path) -> list[str]:
    """Keys the schema knows in the mapping at `path`."""
    found: type[BaseModel] | None = model
    here: Path = ()
    for part in path:
        here = (*here, part)
        if isinstance(part, int) or found is None:
            continue
        if part not in found.model_fields:
            return []
        choices = list(_models(found.model_fields[part].annotation))
        found = choices[0] if len(choices) == 1 else _by_kind(choices, document.at(here))
    names = [] if found is None else [f.alias or n for n, f in found.model_fields.items()]
    return ["schema", *names] if not path else names


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Every model an annotation mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        return
    for argument in get_args(annotation):
        yield from _models(argument)


def _by_kind(choices: list[type[BaseModel]], value: Any) -> type[BaseModel] | None:
    kind = value.get("kind") if isinstance(value, dict) else None
    for choice in choices:
        tag = choice.model_fields.get("kind")
        if tag is not None and kind in get_args(tag.annotation):
            return choice
    return None

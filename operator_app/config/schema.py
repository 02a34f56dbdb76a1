"""Converts a strict YAML document to a checked model, and reports all problems at once.

Wraps pydantic: its errors become `Problem`s with file, line and key. For an unknown key, the problem suggests the key
that was probably meant, and this key is then not reported as missing.

A model is either a `StrictModel`, which builds a domain object, or a dataclass derived from `StrictRecord`, which is a
domain object itself. A dataclass is checked when it is read or written, but not when the program makes it.
"""

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, TypeVar, cast

import pydantic
from pydantic_core import ErrorDetails

from operator_app.config.errors import (
    ConfigError,
    Problem,
    is_near_option,
    value_in_words,
    words_for,
)
from operator_app.config.quantities import TO_SI, UNIT, UNITS, length_doubt
from operator_app.config.strict_yaml import Complaint, Path, YamlDocument, load_strict

VERSIONS: Mapping[str, tuple[int, ...]] = {"parameters": (1, 2, 3)}
"""Readable versions of the format, by kind of file; the last one is written. All other kinds have only version 1."""

UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")


class StrictModel(pydantic.BaseModel):
    """Base of the models that build a domain object: no unknown keys, immutable."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class StrictRecord:
    """Base of the models that are frozen dataclasses: no unknown keys."""

    __slots__ = ()
    __pydantic_config__: ClassVar = pydantic.ConfigDict(extra="forbid")


M = TypeVar("M", bound=StrictModel | StrictRecord)

_ADAPTERS: dict[Any, pydantic.TypeAdapter[Any]] = {}


def adapter(model: type[M]) -> pydantic.TypeAdapter[M]:
    """Return pydantic's adapter of a model, for reading, writing and JSON Schema; built once."""
    if model not in _ADAPTERS:
        _ADAPTERS[model] = pydantic.TypeAdapter(model)
    return _ADAPTERS[model]


Fields = Mapping[str, Any]
"""Valid values of the fields that come before the checked field, by name."""


def checked(check: Callable[[Any, Fields], Iterable[Complaint]]) -> pydantic.AfterValidator:
    """Return an annotation that makes pydantic call `check` with a field's value and the valid fields before this one.

    `check` yields problems of this field or of other places in the file. The problems do not end the validation.
    """

    def validate(value: Any, info: pydantic.ValidationInfo) -> Any:
        cast("list[Complaint]", info.context).extend(check(value, info.data))
        return value

    return pydantic.AfterValidator(validate)


def numbered(place: str, key: str, first: int = 1) -> pydantic.AfterValidator:
    """Return an annotation that requires the items of the list `place` to be numbered from `first` by their `key`."""

    def check(items: Sequence[Any], _: Fields) -> Iterator[Complaint]:
        for k, item in enumerate(items):
            if (number := getattr(item, key)) != k + first:
                text = f"{key} {number} is listed in place of {key} {k + first}"
                yield (place, k, key), text, f"list {key}s {first} to n in order, each once"

    return checked(check)


def read_model(model: type[M], data: bytes, *, kind: str, file: str) -> M:
    """Read the bytes of a file of `kind` (``schema: sarcal/<kind>/1``); raises ConfigError with all its problems."""
    return check_model(model, load_strict(data, file), kind=kind)


def check_model(model: type[M], document: YamlDocument, *, kind: str) -> M:
    """Return the model of a `document` that has already been read; raises ConfigError with all its problems."""
    problems = [*document.problems, *_check_schema(document, kind)]
    body = {key: value for key, value in document.data.items() if key != "schema"}
    notes: list[Complaint] = []
    errors: list[ErrorDetails] = []
    checked: M | None = None
    try:
        checked = adapter(model).validate_python(body, context=notes)
    except pydantic.ValidationError as error:
        errors = error.errors(include_url=False)
    problems += _problems(document, model, errors, notes)
    if problems or checked is None:
        raise ConfigError(problems)
    return checked


def read_by_kind(models: Mapping[str, type[M]], data: bytes, *, kind: str, file: str) -> M:
    """Read a file (``schema: sarcal/<kind>/1``) whose key ``kind`` selects one of `models`; raises ConfigError."""
    document = load_strict(data, file)
    which = document.data.get("kind")
    if isinstance(which, str) and which in models:
        return check_model(models[which], document, kind=kind)
    near = difflib.get_close_matches(str(which), list(models), n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    known = f"{value_in_words(which)} is not a known kind of {kind}"
    text = known if "kind" in document.data else "is missing"
    problem = document.problem(("kind",), text, f"{hint}use one of: {', '.join(models)}")
    raise ConfigError((*document.problems, *_check_schema(document, kind), problem))


def schema_name(kind: str) -> str:
    """Return the value of the ``schema`` line that is written for this kind of file."""
    return f"sarcal/{kind}/{VERSIONS.get(kind, (1,))[-1]}"


def _check_schema(document: YamlDocument, kind: str) -> Iterator[Problem]:
    versions = VERSIONS.get(kind, (1,))
    expected = schema_name(kind)
    line = f"the first line must be `schema: {expected}`"
    if "schema" not in document.data:
        yield document.problem((), "has no schema", line)
        return
    stated = document.data["schema"]
    if stated not in [f"sarcal/{kind}/{version}" for version in versions]:
        text, remedy = f"{stated!r} is not a schema this program knows", line
        match = re.fullmatch(r"sarcal/([a-z]+)/(\d{1,9})", str(stated))
        if match is not None and match[1] != kind:
            text = f"this is a file of kind {match[1]}"
            remedy = f"use a file of kind {kind}, whose first line is `schema: {expected}`"
        elif match is not None:
            text = f"the {kind} file has version {match[2]}"
            known = ", ".join(map(str, versions))
            remedy = f"this program reads version {known}: use a version of sarcal that reads version {match[2]}"
        # All other problems would only follow from this one.
        raise ConfigError((document.problem(("schema",), text, remedy),))
    if next(iter(document.data)) != "schema":
        yield document.problem(("schema",), "is not the first key", line)


def _problems(
    document: YamlDocument,
    model: type[M],
    errors: Iterable[ErrorDetails],
    notes: Sequence[Complaint],
) -> Iterator[Problem]:
    placed = _without_alternatives(document, [(_path(document, error), error) for error in errors])
    missing = {path for path, error in placed if error["type"] == "missing"}
    # If a key is not in the file, a complaint can only be about its default: the key counts as missing.
    missing |= {path for path, _, _ in notes if path not in document.marks}
    meant: set[Path] = set()
    for path, error in placed:
        if error["type"] not in UNKNOWN_KEY:
            continue
        text, remedy, instead = _unknown_key(document, model, path)
        meant |= {instead} & missing
        yield document.problem(path, text, remedy)
    for path, error in placed:
        follows = any(path[: len(bad)] == bad for bad in document.unreadable)
        if not (follows or error["type"] in UNKNOWN_KEY or path in meant):
            yield document.problem(path, *words_for(error))
    yield from (document.problem(*note) for note in notes if note[0] not in meant)


def _without_alternatives(
    document: YamlDocument, placed: list[tuple[Path, ErrorDetails]]
) -> list[tuple[Path, ErrorDetails]]:
    """Return the errors, reduced to one alternative for a field that allows a keyword or another type.

    If a value is neither, pydantic reports errors about both. The error about the keyword is kept if the value is like
    an allowed keyword, or is text in a field that allows no number. Otherwise, the errors about the type are kept.
    """
    remaining = list(placed)
    for path, error in placed:
        if error["type"] != "literal_error":
            continue
        rest = [e for p, e in placed if p[: len(path)] == path and e is not error]
        value = document.at(path)
        numeric = any(e["type"].startswith(("float", "int")) for e in rest)
        word = isinstance(value, str) and (not numeric or is_near_option(error))
        if word and rest:
            error["ctx"]["other_type"] = rest[0]["type"].partition("_")[0]
        dropped = rest if word else [error] if rest else []
        remaining = [item for item in remaining if not any(item[1] is e for e in dropped)]
    return remaining


def _path(document: YamlDocument, error: ErrorDetails) -> Path:
    """Return pydantic's location as a path in the file, without the names of alternatives that pydantic inserts."""
    path: Path = ()
    loc = error["loc"]
    for depth, part in enumerate(loc):
        absent = error["type"] == "missing" and depth == len(loc) - 1
        if absent or (*path, part) in document.marks:
            path = (*path, part)
    return path


def _unknown_key(document: YamlDocument, model: type[M], path: Path) -> tuple[str, str, Path]:
    """Return text and remedy for an unknown key, and the path of the most similar key, empty if there is none."""
    key, parent = str(path[-1]), path[:-1]
    known = _keys(document, model, parent)
    present = document.at(parent)
    open_keys = [k for k in known if k not in present]
    value = document.at(path)
    text = "unknown key"
    match = UNIT.fullmatch(key)
    # `tolerance_rad` is meant to be `tolerance_deg`, not `tolerance_mm`.
    for candidate in sorted(known, key=lambda name: _si_unit(name) != _si_unit(key)):
        other = UNIT.fullmatch(candidate)
        if match is None or other is None or match[1] != other[1]:
            continue
        if match[2] == "m" and isinstance(value, int | float) and length_doubt(value):
            text += f", and {length_doubt(value)}"
        remedy = f"give the value in {UNITS[other[2]]}, as {candidate}"
        return text, remedy, (*parent, candidate)
    bare = [c for c in open_keys if (unit := UNIT.fullmatch(c)) is not None and unit[1] == key]
    if near := bare or difflib.get_close_matches(key, open_keys, n=1, cutoff=0.6):
        return text, f"did you mean {near[0]}?", (*parent, near[0])
    return text, f"known here: {', '.join(known)}" if known else "remove it", ()


def _si_unit(name: str) -> str:
    match = UNIT.fullmatch(name)
    return "" if match is None else TO_SI.get(match[2], (match[2],))[0]


def _keys(document: YamlDocument, model: type[M], path: Path) -> list[str]:
    schema = adapter(model).json_schema()
    nodes = [schema]
    for depth, part in enumerate(path, 1):
        value = document.at(path[:depth])
        children = (
            n.get("items") if isinstance(part, int) else n.get("properties", {}).get(part)
            for n in nodes
        )
        nodes = [choice for child in children if child for choice in _choices(child, schema, value)]
    names = [name for node in nodes for name in node.get("properties", {})]
    return ["schema", *names] if not path else names


def _choices(node: dict[str, Any], schema: dict[str, Any], value: Any) -> list[dict[str, Any]]:
    """Return the alternatives in `node`, a part of the JSON Schema `schema`, that allow the ``kind`` of `value`."""
    if "$ref" in node:
        return [schema["$defs"][node["$ref"].rpartition("/")[2]]]
    # Older versions of pydantic write a reference with a default as allOf of one.
    options = (option for word in ("anyOf", "oneOf", "allOf") for option in node.get(word, ()))
    choices = [choice for option in options for choice in _choices(option, schema, value)]
    if not choices:
        return [node]
    kind = value.get("kind") if isinstance(value, dict) else None
    kinds = [n.get("properties", {}).get("kind", {}).get("const", kind) for n in choices]
    return [n for n, own in zip(choices, kinds, strict=True) if own == kind]

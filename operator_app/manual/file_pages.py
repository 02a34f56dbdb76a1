"""The pages of our YAML files, from the models that read them and the files that are packaged."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any, Literal

from operator_app.config.json_schemas import json_schema
from operator_app.config.resources import builtin_names, resolve
from operator_app.manual.markup import table

FileKind = Literal["arm", "fixture", "procedure", "profile", "parameters"]
FILE_KINDS: tuple[FileKind, ...] = ("arm", "fixture", "procedure", "profile", "parameters")

EXAMPLES: Mapping[str, str] = {
    "arm": "sarcos_dextrous",
    "fixture": "hinge",
    "procedure": "hinge",
    "profile": "sarcos",
}
"""Packaged file that is printed whole: its comments explain it."""

PURPOSE: Mapping[FileKind, str] = {
    "arm": "An arm file holds the Denavit-Hartenberg table, the sensors and the ranges of an arm, and how "
    "well each is known.",
    "fixture": "A fixture file says what is bolted between tool and table, and where.",
    "procedure": "A procedure file says what `sarcal run` does: arm, fixture, bus, modes, poses, limits.",
    "profile": "A bus profile says how the arm's CANopen nodes are set up. `sarcal probe --draft FILE` "
    "writes one.",
    "parameters": "A parameters file holds the result of a calibration. `sarcal export` writes it; it is "
    "not edited by hand.",
}


def file_page(kind: FileKind) -> str:
    """Return the page of a kind of file."""
    schema = json_schema(kind)
    models = schema["$defs"]
    tops = [choice["$ref"].rpartition("/")[2] for choice in schema["oneOf"]]
    title = "Bus profile" if kind == "profile" else f"{kind.capitalize()} file"
    blocks = [
        f"# {title}",
        PURPOSE[kind],
        (
            "YAML. Unknown keys, duplicate keys, wrong units and values that are not numbers are errors; all of "
            "them are listed at once, with file, line and key. A name ends in its unit: `_m`, `_mm`, `_deg`, "
            "`_mrad`, `_s`."
        ),
    ]
    if kind in EXAMPLES:
        blocks += list(_example(kind))
    for name in [*tops, *(name for name in models if name not in tops)]:
        blocks += list(_model(name, models[name], models))
    return "\n\n".join(blocks) + "\n"


def _example(kind: str) -> Iterator[str]:
    known: Any = kind
    names = ", ".join(f"`{name}`" for name in builtin_names(known))
    yield f"Packaged: {names}."
    yield f"## The packaged {EXAMPLES[kind]}"
    yield f"```yaml\n{resolve(known, EXAMPLES[kind]).data.decode().rstrip()}\n```"


def _model(name: str, model: Mapping[str, Any], models: Mapping[str, Any]) -> Iterator[str]:
    about, of_keys = _docstring(model.get("description", ""))
    required = model.get("required", ())
    rows = [
        (
            f"`{key}`",
            _type(spec, models),
            "required" if key in required else _default(spec),
            spec.get("description") or of_keys.get(key, ""),
        )
        for key, spec in model.get("properties", {}).items()
    ]
    yield f"## {heading(name)}"
    if about:
        yield about
    yield table(("key", "value", "default", "meaning"), rows)


def heading(model: str) -> str:
    """Return how a model is called on the page: ``RvdtModel`` is an Rvdt."""
    bare = re.sub(r"(Model|Spec)$", "", model)
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", bare).lower()
    return words[:1].upper() + words[1:]


def _docstring(text: str) -> tuple[str, dict[str, str]]:
    """Return what a model is, and what its docstring says of each key."""
    about, _, attributes = text.replace("``", "`").partition("Attributes\n----------\n")
    of_keys = {}
    for names, said in re.findall(r"^(\w[\w, ]*)\n((?:    .*\n?)+)", attributes, re.MULTILINE):
        of_keys.update({name.strip(): " ".join(said.split()) for name in names.split(",")})
    return " ".join(about.split()), of_keys


def _type(spec: Mapping[str, Any], models: Mapping[str, Any]) -> str:
    """Say what a value may be."""
    if "$ref" in spec:
        name = spec["$ref"].rpartition("/")[2]
        return f"see [{heading(name)}](#{heading(name).lower().replace(' ', '-')})"
    if "const" in spec:
        return f"`{spec['const']}`"
    if "enum" in spec:
        return " or ".join(f"`{value}`" for value in spec["enum"])
    choices = spec.get("anyOf") or spec.get("oneOf")
    if choices:
        return " or ".join(_type(c, models) for c in choices if c.get("type") != "null")
    match spec.get("type"):
        case "array" if "prefixItems" in spec:
            items = [_type(item, models) for item in spec["prefixItems"]]
            return f"{len(items)} of: {items[0]}"
        case "array":
            return f"list of: {_type(spec['items'], models)}"
        case "object":
            return f"mapping to: {_type(spec.get('additionalProperties') or {}, models)}"
        case "number" | "integer" as number:
            return _number(spec, "number" if number == "number" else "whole number")
        case "boolean":
            return "true or false"
        case "string":
            return "text"
    return "anything"


def _number(spec: Mapping[str, Any], word: str) -> str:
    low, high = spec.get("minimum"), spec.get("maximum")
    above = spec.get("exclusiveMinimum")
    if low is not None and high is not None:
        return f"{word}, {low:g} to {high:.10g}"
    if above is not None and (low is None or low <= above):
        limit = f" to {high:.10g}" if high is not None else ""
        return f"{word} above {above:g}{limit}"
    return f"{word}, at least {low:g}" if low is not None else word


def _default(spec: Mapping[str, Any]) -> str:
    found = spec.get("default")
    return "" if found is None or found == {} else f"`{json.dumps(found)}`"

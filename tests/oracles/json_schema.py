"""What a JSON Schema says about a value, for the keywords our schemas use; any other keyword is an error."""

import re
from collections.abc import Callable, Iterator
from typing import Any

SAYS_NOTHING = {
    "title", "description", "default", "discriminator", "$defs", "$schema", "additionalProperties",
}  # fmt: skip
TYPES = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}


def is_number(value: Any) -> bool:
    """Whether a value is a number: true is none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_type(value: Any, name: str) -> bool:
    """Whether a value is of a JSON type; 1.0 is no integer (as YAML writes it)."""
    if name in TYPES:
        return isinstance(value, TYPES[name])
    return is_number(value) and (name == "number" or isinstance(value, int))


HOLDS: dict[str, Callable[[Any, Any], bool]] = {
    "type": lambda v, w: any(is_type(v, name) for name in ([w] if isinstance(w, str) else w)),
    "const": lambda v, w: v == w,
    "enum": lambda v, w: v in w,
    "minimum": lambda v, w: not is_number(v) or v >= w,
    "maximum": lambda v, w: not is_number(v) or v <= w,
    "exclusiveMinimum": lambda v, w: not is_number(v) or v > w,
    "minLength": lambda v, w: not isinstance(v, str) or len(v) >= w,
    "pattern": lambda v, w: not isinstance(v, str) or re.search(w, v) is not None,
    "minItems": lambda v, w: not isinstance(v, list) or len(v) >= w,
    "maxItems": lambda v, w: not isinstance(v, list) or len(v) <= w,
    "required": lambda v, w: not isinstance(v, dict) or set(w) <= set(v),
}


def parts(value: Any, schema: dict[str, Any]) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Yield values inside a value, and the schema of each."""
    if isinstance(value, dict):
        known = schema.get("properties", {})
        rest = schema.get("additionalProperties", {})
        nothing: dict[str, Any] = {"enum": []}
        for key, item in value.items():
            yield item, known.get(key, nothing if rest is False else rest)
    if isinstance(value, list):
        yield from zip(value, schema.get("prefixItems", ()), strict=False)
        yield from ((item, schema["items"]) for item in value if "items" in schema)


def complaints(value: Any, schema: dict[str, Any], root: dict[str, Any]) -> Iterator[str]:
    """Yield everything the schema has against a value."""
    for word, wanted in schema.items():
        if word in HOLDS:
            if not HOLDS[word](value, wanted):
                yield f"{value!r} against {word} {wanted}"
        elif word == "$ref":
            yield from complaints(value, root["$defs"][wanted.split("/")[-1]], root)
        elif word in ("anyOf", "oneOf"):
            fits = sum(not list(complaints(value, option, root)) for option in wanted)
            if not fits or (word == "oneOf" and fits > 1):
                yield f"{value!r} fits {fits} of {len(wanted)} choices"
        elif word == "allOf":
            for option in wanted:
                yield from complaints(value, option, root)
        elif word not in SAYS_NOTHING | {"properties", "items", "prefixItems"}:
            raise NotImplementedError(f"keyword {word}")
    for item, own in parts(value, schema):
        yield from complaints(item, own, root)

"""A JSON Schema validator for the keywords of our schemas; any other keyword is an error."""

import re
from collections.abc import Callable, Iterator
from typing import Any

IGNORED_KEYWORDS = {
    "title", "description", "default", "discriminator", "$defs", "$schema", "additionalProperties",
}  # fmt: skip
TYPES = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_type(value: Any, name: str) -> bool:
    """Whether a value is of a JSON type; 1.0 is no integer."""
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
    """Yield the items of a value, and the schema of each."""
    if isinstance(value, dict):
        known = schema.get("properties", {})
        additional = schema.get("additionalProperties", {})
        no_value: dict[str, Any] = {"enum": []}
        for key, item in value.items():
            yield item, known.get(key, no_value if additional is False else additional)
    if isinstance(value, list):
        yield from zip(value, schema.get("prefixItems", ()), strict=False)
        yield from ((item, schema["items"]) for item in value if "items" in schema)


def complaints(value: Any, schema: dict[str, Any], root: dict[str, Any]) -> Iterator[str]:
    """Yield every violation of the schema by a value."""
    for keyword, expected in schema.items():
        if keyword in HOLDS:
            if not HOLDS[keyword](value, expected):
                yield f"{value!r} against {keyword} {expected}"
        elif keyword == "$ref":
            yield from complaints(value, root["$defs"][expected.split("/")[-1]], root)
        elif keyword in ("anyOf", "oneOf"):
            fits = sum(not list(complaints(value, option, root)) for option in expected)
            if not fits or (keyword == "oneOf" and fits > 1):
                yield f"{value!r} fits {fits} of {len(expected)} choices"
        elif keyword == "allOf":
            for option in expected:
                yield from complaints(value, option, root)
        elif keyword not in IGNORED_KEYWORDS | {"properties", "items", "prefixItems"}:
            raise NotImplementedError(f"keyword {keyword}")
    for item, own in parts(value, schema):
        yield from complaints(item, own, root)

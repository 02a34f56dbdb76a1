"""Errors of files that people edit, and the translation of pydantic's errors for the operator."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """One problem of a file.

    `file`: name of the file as the user typed it, or ``packaged:<name>.yaml`` for a built-in file.
    `line`: number of the line, from 1; None if the problem concerns the whole file.
    `column`: number of the character in the line (YAML) or of the field (CSV), from 1.
    `key`: path of the value, see `YamlDocument.name` (``joints[joint 6].sensor.bits``), or name of the CSV column; ""
    for the whole file.
    """

    file: str
    line: int | None = None
    column: int | None = None
    key: str = ""
    text: str
    remedy: str = ""

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        line = f"{place}: {self.key}: {self.text}" if self.key else f"{place}: {self.text}"
        if self.remedy:
            # After a question mark, no semicolon.
            line += f"{'' if line.endswith('?') else ';'} {self.remedy}"
        # One line whatever the file holds, without characters that a terminal would interpret.
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


class ConfigError(Exception):
    """A file cannot be used. `problems` lists all problems, in the order of the file."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(problems, key=lambda p: (p.line or 0, p.column or 0)))
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[type[ConfigError], tuple[tuple[Problem, ...]]]:
        """Pickle the problems, which are the argument of `__init__`; the error may be raised in another process."""
        return type(self), (self.problems,)


class WriteError(Exception):
    """A file could not be written; an existing file is unchanged."""

    def __init__(self, *, file: str, reason: str) -> None:
        self.file = file
        self.reason = reason
        super().__init__(f"{file}: cannot be written: {reason}")


def decode_text(data: bytes, file: str) -> str:
    """Decode UTF-8, with or without a byte order mark; raises ConfigError for anything else."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise only(file, "is UTF-16 text", "save it as UTF-8")
    if b"\0" in data:
        raise only(file, "is a binary file", "is this the right file?")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise only(file, "is not UTF-8 text", "save it as UTF-8", line=line) from error


def only(
    file: str, text: str, remedy: str, *, line: int | None = None, column: int | None = None
) -> ConfigError:
    """Return a ConfigError with a single problem."""
    return ConfigError((Problem(file=file, line=line, column=column, text=text, remedy=remedy),))


MAPPING = "a mapping (`key: value` lines)"
TYPES_IN_WORDS = {
    "float": "a number", "int": "a whole number", "bool": "true or false", "string": "text",
    "tuple": "a list", "list": "a list", "dict": MAPPING, "dataclass": MAPPING, "model": MAPPING,
}  # fmt: skip
"""Required type as text, keyed by the first word of pydantic's error type."""

LIMITS_IN_WORDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}


def words_for(error: ErrorDetails) -> tuple[str, str]:
    """Translate a pydantic error into problem and remedy for the operator."""
    kind, context = error["type"], error.get("ctx", {})
    value = error["input"]
    if kind == "missing":
        return "is missing", "add it"
    if kind == "refused":
        return str(context["what"]), str(context["remedy"])
    if kind == "union_tag_not_found":
        key = str(context.get("discriminator", "")).strip("'")
        return f"has no {key}", f"add the key {key}"
    if kind in ("union_tag_invalid", "literal_error"):
        options = _options(context)
        near = difflib.get_close_matches(str(context.get("tag", value)), options, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        shown = context.get("tag", value_in_words(value))
        use = f"use {'one of: ' * (len(options) > 1)}{', '.join(options)}"
        other = TYPES_IN_WORDS.get(context.get("other_type", ""))
        return f"{shown} is not a valid value", f"{hint}{use}{f', or {other}' if other else ''}"
    expected = TYPES_IN_WORDS.get(kind.partition("_")[0])
    if expected and kind.endswith(("_type", "_from_float")):
        return f"must be {expected}, not {value_in_words(value)}", _number_hint(value, kind)
    if kind in LIMITS_IN_WORDS:
        name, limit_words = LIMITS_IN_WORDS[kind]
        limit, given = (v if isinstance(v, int) else f"{v:g}" for v in (context[name], value))
        return f"must be {limit_words} {limit}, not {given}", "correct the number"
    if kind in ("too_short", "too_long"):
        limit = f"it may have at most {context.get('max_length')}"
        if kind == "too_short":
            limit = f"it needs at least {context['min_length']}"
        return f"has {context['actual_length']} items; {limit}", "correct the list"
    if kind == "string_too_short":
        return "is empty", "state it"
    return str(error["msg"]), "correct the value"


def shortened(text: str) -> str:
    """Return text for a message: its first 40 characters, followed by ``...`` if it is longer."""
    return text if len(text) <= 40 else f"{text[:40]}..."


def value_in_words(value: Any) -> str:
    """Describe a value for use in a sentence."""
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {shortened(value)!r}"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, dict):
        return "a mapping"
    return f"{value}"


NUMBER_HINTS = {
    r"[-+]?\d+,\d+": "write a decimal point, not a comma",
    r"[-+]?\d+(:\d+)+(\.\d*)?": "write a decimal number, not hours or degrees and minutes",
    r"[-+]?0\d+(\.\d*)?": "write the number without the leading zero",
    r"[-+]?[\d.]+\s*[A-Za-z]+": "write only the number, in the unit at the end of the key (_m, _mm, _rad, _deg)",
}
"""Remedies for a text where a number is required, keyed by pattern; the first pattern that matches the text applies."""


def _number_hint(value: Any, kind: str) -> str:
    if value is None:
        return "state it"
    if kind == "string_type" and isinstance(value, int | float):
        # For a number with a point, the digits in the file are not known: 1.1 may be 1.10 there.
        return "write it in quotes" + (f": '{value}'" if type(value) is int else "")
    if not isinstance(value, str):
        return "correct the value"
    if kind == "bool_type":
        return "write true or false"
    hints = NUMBER_HINTS.items() if kind.startswith(("float", "int")) else ()
    return next((hint for form, hint in hints if re.fullmatch(form, value)), "correct the value")


def is_near_option(error: ErrorDetails) -> bool:
    """Whether the refused value resembles one of the allowed words."""
    options = _options(error.get("ctx", {}))
    return bool(difflib.get_close_matches(str(error["input"]), options, n=1))


def _options(context: dict[str, Any]) -> list[str]:
    listed = str(context.get("expected_tags") or context.get("expected") or "")
    return re.findall(r"'([^']*)'", listed) or re.findall(r"-?\d+", listed)

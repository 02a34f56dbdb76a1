"""Reads strict YAML and records the line of every key.

A subset of YAML 1.2: mappings, lists and plain scalars. Numbers are decimal, booleans are ``true`` and ``false``.
Values that only YAML 1.1 reads as another type (``yes``, ``12:30``, ``0x1F``, ``010``, dates) remain text, which a
schema then refuses where a number is required. Anchors, aliases, tags, merge keys, duplicate keys and non-finite
numbers are refused.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import yaml
from yaml.events import AliasEvent
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from operator_app.config.errors import Problem, decode_text, only
from operator_app.config.resources import YAML_LIMIT_BYTES

MAX_DEPTH = 20

INTEGER = re.compile(r"[-+]?(?:0|[1-9][0-9]*)")
YAML_NUMBER = re.compile(r"[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
YAML_NOT_FINITE = re.compile(r"[-+]?\.inf|\.nan|[-+]?(?:inf|infinity|nan)", re.IGNORECASE)
NULLS = ("", "~", "null", "Null", "NULL")
TRUE = ("true", "True", "TRUE")
FALSE = ("false", "False", "FALSE")

Scalar = str | int | float | bool | None


def load_strict(data: bytes, file: str) -> YamlDocument:
    """Read one YAML mapping; raises ConfigError for anything else.

    A problem of a single key or value is not raised, but listed in `YamlDocument.problems` of the result.
    """
    if len(data) > YAML_LIMIT_BYTES:
        text = f"is larger than {YAML_LIMIT_BYTES // 1024} KiB"
        raise only(file, text, "this is probably the wrong file")
    text = decode_text(data, file)
    if text.lstrip().startswith("<"):
        remedy = "make an arm file from a URDF first: sarcal new arm --urdf FILE"
        raise only(file, "is XML, not YAML", remedy, line=1)
    try:
        node = _composed(text)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        what = "contains a character that is not text"
        raise only(file, what, "is this the right file?", line=line) from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
        what, remedy = _syntax(error, text, line)
        raise only(file, what, remedy, line=line, column=column) from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        # PyYAML passes on the errors of chr() and int() for absurd escapes and directives.
        raise only(
            file, "cannot be read as YAML", "check escapes (\\u) and lines with %"
        ) from error
    if node is None:
        raise only(file, "is empty", "write `key: value` lines, or restore the file")
    if not isinstance(node, MappingNode):
        what, mark = "is not a list of `key: value` lines", node.start_mark
        remedy = "write one key per line, or restore the file"
        raise only(file, what, remedy, line=mark.line + 1, column=mark.column + 1)
    document = YamlDocument(file=file)
    document.data = document.build(node, ())
    return document


@lru_cache(maxsize=16)
def _composed(text: str) -> Node | None:
    """Return the root node of YAML text. Results are cached, since a session reads the same built-in files often."""
    node: Node | None = StrictLoader(text).get_single_node()
    return node


def resolve_plain(text: str) -> Scalar:
    """Return the value of an unquoted scalar; inf for a number that is not finite or too large for a double.

    Raises `ValueError` for a number with too many digits.
    """
    if text in NULLS:
        return None
    if text in TRUE or text in FALSE:
        return text in TRUE
    if INTEGER.fullmatch(text):
        if len(text) > 40:
            raise ValueError("a number of more than 40 digits")
        return int(text)
    if YAML_NUMBER.fullmatch(text):
        return float(text)
    if YAML_NOT_FINITE.fullmatch(text):
        return math.inf
    return text


class StrictLoader(yaml.SafeLoader):
    """SafeLoader that refuses anchors, aliases, tags and deep nesting while composing."""

    depth = 0

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """Compose one node; refuse anything but plain data."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        mark = event.start_mark
        if isinstance(event, AliasEvent) or getattr(event, "anchor", None) is not None:
            raise yaml.composer.ComposerError(None, None, "anchors and aliases (& and *)", mark)
        if getattr(event, "tag", None) is not None:
            raise yaml.composer.ComposerError(None, None, "tags (!)", mark)
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise yaml.composer.ComposerError(None, None, "is nested too deeply", mark)
        try:
            return super().compose_node(parent, index)
        finally:
            self.depth -= 1


def _syntax(error: yaml.MarkedYAMLError, text: str, line: int) -> tuple[str, str]:
    lines = text.splitlines()
    shown = lines[line - 1] if 0 < line <= len(lines) else ""
    problem = str(error.problem or error.context or "")
    if isinstance(error, yaml.composer.ComposerError):
        if "single document" in str(error.context) or "but found another document" in problem:
            return "contains a second document (---)", "write each document to a file of its own"
        what = problem if "deep" in problem else f"{problem} are not supported"
        return what, "write the values out"
    if "\\t" in problem or "\t" in shown:
        return "has a tab where YAML needs spaces", "indent with spaces"
    return f"is not YAML: {problem}", "check indentation, colons and quotes in this line"


Mark = tuple[int, int]
"""Line and column, from 1."""


def _mark(node: Node) -> Mark:
    return node.start_mark.line + 1, node.start_mark.column + 1


Path = tuple[str | int, ...]
"""Path of a value: keys and list indices from 0."""

Complaint = tuple[Path, str, str]
"""A problem: path of the value, text, remedy."""


@dataclass(slots=True, kw_only=True)
class YamlDocument:
    """A YAML mapping; made by `load_strict`.

    `data`: its content as dict, list, str, int, float, bool and None.
    `marks`: line and column of every key and list item, by path; the empty path is that of the whole mapping.
    `complaints`: for each problem of a single key or value: path, problem, remedy, and line and column.
    `unreadable`: paths of values that could not be read; `data` has a placeholder for each of them.
    """

    file: str
    data: dict[str, Any] = field(default_factory=dict)
    marks: dict[Path, Mark] = field(default_factory=dict)
    complaints: list[tuple[Path, str, str, Mark]] = field(default_factory=list)
    unreadable: set[Path] = field(default_factory=set)

    def build(self, node: Node, path: Path) -> Any:
        """Return a node as plain data, and record its line, column and problems."""
        self.marks.setdefault(path, _mark(node))
        if isinstance(node, ScalarNode):
            return self._scalar(node, path)
        if isinstance(node, SequenceNode):
            return [self.build(item, (*path, k)) for k, item in enumerate(node.value)]
        return self._mapping(node, path)

    def _mapping(self, node: Node, path: Path) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, ScalarNode):
                text = "has a list or a mapping as a key"
                self._complain(key_node, path, text, "write `key: value`")
                continue
            key = str(key_node.value)
            key_path = (*path, key)
            if key == "<<" and key_node.style is None:
                text = "merge keys are not supported"
                self._complain(key_node, key_path, text, "write the keys out")
            elif key in out:
                text = f"is given twice (first in line {self.marks[key_path][0]})"
                self._complain(key_node, key_path, text, "keep one of them")
            else:
                self.marks[key_path] = _mark(key_node)
                out[key] = self.build(value_node, key_path)
        return out

    def _scalar(self, node: ScalarNode, path: Path) -> Scalar:
        text, what = str(node.value), ""
        value: Scalar = None
        if node.style is not None:
            value, remedy = text, "write the character itself"
            if any("\ud800" <= c <= "\udfff" for c in text):
                what = "contains half a character (an escape \\ud800 to \\udfff)"
        else:
            try:
                value, remedy = resolve_plain(text), "give a finite number"
                if isinstance(value, float) and not math.isfinite(value):
                    what = f"{text} is not a finite number"
            except ValueError as error:
                what, remedy = f"is {error}", "check the number"
        if what:
            self._complain(node, path, what, remedy)
            self.unreadable.add(path)
        return value

    def _complain(self, node: Node, path: Path, text: str, remedy: str) -> None:
        # Report the place of this node: the second of two equal keys has another line.
        self.complaints.append((path, text, remedy, _mark(node)))

    @property
    def problems(self) -> tuple[Problem, ...]:
        """Problems of single keys and values; the rest of the document was read."""
        return tuple(self.problem(*complaint) for complaint in self.complaints)

    def problem(self, path: Path, text: str, remedy: str = "", mark: Mark | None = None) -> Problem:
        """Return a problem about the value at `path`.

        `mark`: line and column. None means the place of the value or, for a missing value, of the nearest parent.
        """
        place = path
        while place and place not in self.marks:
            place = place[:-1]
        line, column = mark or self.marks.get(place, (1, 1))
        key = self.name(path)
        return Problem(file=self.file, line=line, column=column, key=key, text=text, remedy=remedy)

    def at(self, path: Path) -> Any:
        """Return the value at `path`; None if there is none."""
        value: Any = self.data
        for part in path:
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                return None
        return value

    def name(self, path: Path) -> str:
        """Return a path as text; a list item is named by its ``row``, ``joint`` or ``entry``, else by number from 1."""
        text = ""
        for depth, part in enumerate(path):
            if isinstance(part, str):
                text += f".{_shown(part)}" if text else _shown(part)
                continue
            item = self.at(path[: depth + 1])
            label = str(part + 1)
            if isinstance(item, dict):
                own = next((k for k in ("row", "joint", "entry") if k in item), None)
                if own is not None and isinstance(item[own], str | int):
                    label = f"{own} {item[own]}" if own != "entry" else str(item[own])
            text += f"[{_shown(label)}]"
        return text


def _shown(text: str) -> str:
    plain = text if text.isprintable() and text else repr(text)
    return plain if len(plain) <= 60 else plain[:57] + "..."

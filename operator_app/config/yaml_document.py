"""A YAML mapping as read, with the line of every key, and how its places are named. Knows no syntax."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from operator_app.config.errors import Problem

Path = tuple[str | int, ...]
"""Where a value is: keys and list indices from 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class YamlDocument:
    """A mapping as read.

    Attributes
    ----------
    file
        Name for messages.
    data
        The top mapping: plain dicts, lists, str, int, float, bool, None.
    marks
        Line and column (from 1) of every key and list item, by path; ``()`` is the document.
    problems
        What was refused on the way but did not keep the rest from being read.
    unreadable
        Paths whose values are placeholders, because of one of the problems.
    """

    file: str
    data: dict[str, Any]
    marks: Mapping[Path, tuple[int, int]]
    problems: tuple[Problem, ...]
    unreadable: frozenset[Path]

    def problem(self, path: Path, text: str, remedy: str = "") -> Problem:
        """Build a problem at `path`, or at the nearest parent that is in the file."""
        place = path
        while place and place not in self.marks:
            place = place[:-1]
        line, column = self.marks.get(place, (1, 1))
        return Problem(
            file=self.file,
            line=line,
            column=column,
            key=self.name(path),
            text=text,
            remedy=remedy,
        )

    def at(self, path: Path) -> Any:
        """Value at `path`; None where there is none."""
        value: Any = self.data
        for part in path:
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                return None
        return value

    def name(self, path: Path) -> str:
        """Write a path for people: list items by their own number where they have one."""
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
    """A key as part of one line of text, whatever it holds."""
    plain = text if text.isprintable() and text else repr(text)
    return plain if len(plain) <= 60 else plain[:57] + "..."

"""Lines for a terminal, made of spans; a span is text with a role, which selects its style."""

import textwrap
from collections.abc import Sequence
from functools import partial

Span = tuple[str, str]
Line = tuple[Span, ...]


def line(*parts: str | Span) -> Line:
    """Make a line of spans; plain strings get the role ``text``."""
    return tuple((p, "text") if isinstance(p, str) else p for p in parts)


def entry(label: str, *parts: str | Span, column: int = 12) -> Line:
    """Make a line with a label at its left, in a column of `column` characters."""
    return line((f" {label:<{column - 1}}", "dim"), *parts)


short_entry = partial(entry, column=11)
"""Make a line with a label in a narrower column, for the steps of the terminal app that show a drawing."""


def wrapped_entry(
    label: str, text: str, width: int, column: int = 12, role: str = "text"
) -> list[Line]:
    """Wrap text to `width` characters, with a label at the left of the first line; no line breaks at U+00A0."""
    rows = textwrap.wrap(text, max(width - column, 8)) or [""]
    return [
        entry(label if k == 0 else "", (row.replace("\xa0", " "), role), column=column)
        for k, row in enumerate(rows)
    ]


def length(of: Line) -> int:
    """Return the number of cells that a line takes; the program uses only characters that are one cell wide."""
    return sum(len(text) for text, _ in of)


def clip(of: Line, width: int) -> Line:
    """Cut a line to a width, with an ellipsis if it was longer."""
    if length(of) <= width:
        return of
    out: list[Span] = []
    room = width - 1
    for text, role in of:
        if room <= 0:
            break
        out.append((text[:room], role))
        room -= len(text[:room])
    return (*out, ("…", "dim")) if width > 0 else ()


def cut(rows: list[Line], width: int, height: int, more: str) -> list[Line]:
    """Return at most `height` rows; if some are cut off, the last row ends with the text `more`."""
    if len(rows) <= height:
        return rows
    if height < 1:
        return []
    *shown, last = rows[:height]
    text = "".join(text for text, _ in last)[: width - 1 - len(more)].rstrip()
    return [*shown, ((text + more, last[-1][1]),)]


def wrapped(text: str, width: int, role: str = "text", indent: str = "") -> list[Line]:
    """Wrap text to lines of `width` characters; continuation lines begin with `indent`."""
    rows = textwrap.wrap(text, max(width, 8), subsequent_indent=indent, break_long_words=True)
    return [((row, role),) for row in rows] or [()]


def window(rows: Sequence[Line], first: int, height: int) -> tuple[list[Line], int, int]:
    """Return the visible part of a list scrolled to row `first`: lines, number of rows, and index of the first row.

    If not all rows fit, the last line is not a row: it counts the rows hidden below or, at the end, those above.
    """
    if len(rows) <= height:
        return list(rows), len(rows), 0
    room = max(1, height - 1)
    first = max(0, min(first, len(rows) - room))
    below = len(rows) - first - room
    more = f" {below} more below (Down)" if below else f" {first} more above (Up)"
    return [*rows[first : first + room], ((more, "dim"),)], room, first

"""Markdown as our pages use it, as lines of text for a terminal of any width. Knows no page and no colour.

Headings, paragraphs, lists, tables, fenced code, links and pictures. A link to another page shows its
topic, a picture what it shows; comments are for tests and not shown.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")
PICTURE = re.compile(r"!\[([^\]]*)\]\([^)]*\)")
COMMENT = re.compile(r"<!--.*?-->\n?", re.DOTALL)
ITEM = re.compile(r"( *)([-*]|\d+\.) +(.*)")
ESCAPED_BAR = "\\|"
MANY_COLUMNS, TALLEST = 4, 8
"""A table of so many columns, with a cell of more lines than that, cannot be read side by side."""


def as_text(markdown: str, width: int) -> str:
    """Return a page as text, at most `width` characters wide but for code and words longer than that."""
    return "\n".join(_lines(COMMENT.sub("", markdown), width)).strip("\n") + "\n"


def _lines(markdown: str, width: int) -> Iterator[str]:
    rows = markdown.splitlines()
    at = 0
    while at < len(rows):
        row = rows[at]
        end = at + 1
        if row.startswith("```"):
            while end < len(rows) and not rows[end].startswith("```"):
                end += 1
            yield from (f"    {code}".rstrip() for code in rows[at + 1 : end])
            end += 1
        elif row.startswith("#"):
            yield from _heading(row, width)
        elif row.startswith("|"):
            while end < len(rows) and rows[end].startswith("|"):
                end += 1
            yield from _table([_cells(r) for r in rows[at:end]], width)
        elif row.strip():
            while end < len(rows) and rows[end].strip() and not _begins(rows[end]):
                end += 1
            yield from _paragraph(rows[at:end], width)
        else:
            yield ""
        at = end


def _begins(row: str) -> bool:
    """Whether a row ends the paragraph before it."""
    return row.startswith(("```", "#", "|")) or ITEM.fullmatch(row) is not None


def _heading(row: str, width: int) -> Iterator[str]:
    level = len(row) - len(row.lstrip("#"))
    text = _inline(row[level:].strip())
    yield from textwrap.wrap(text, width)
    if level <= 2:  # a title, a section
        yield ("=" if level == 1 else "-") * min(len(text), width)


def _paragraph(rows: Sequence[str], width: int) -> list[str]:
    first, rest = "", ""
    text = " ".join(row.strip() for row in rows)
    if item := ITEM.fullmatch(rows[0]):
        first = f"{item[1]}{item[2]} "
        rest = " " * len(first)
        text = " ".join([item[3], *(row.strip() for row in rows[1:])])
    return _wrapped(_inline(text), width, first, rest)


def _wrapped(text: str, width: int, first: str = "", rest: str = "") -> list[str]:
    return textwrap.wrap(
        text, width, initial_indent=first, subsequent_indent=rest,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _inline(text: str) -> str:
    """Return text without the marks that a terminal has no use for."""
    text = PICTURE.sub(r"[Picture: \1]", text)
    text = LINK.sub(lambda m: m[1] + _target(m[2]), text)
    return text.replace("**", "").replace(ESCAPED_BAR, "|")


def _target(link: str) -> str:
    """Return what to ask for: the topic of another page, the address of anything else but this page."""
    page = re.fullmatch(r"([a-z0-9-]+)\.md(#.*)?", link)
    if page:
        return f" (sarcal help {page[1]})"
    return "" if link.startswith("#") else f" ({link})"


def _cells(row: str) -> list[str]:
    return [_inline(cell.strip()) for cell in re.split(r"(?<!\\)\|", row.strip())[1:-1]]


def _table(rows: Sequence[list[str]], width: int) -> Iterator[str]:
    """Align columns; the widest give way until the table fits."""
    body = [row for row in rows if not all(re.fullmatch(r":?-+:?", cell) for cell in row)]
    columns = list(zip(*body, strict=True))
    wide = [max(len(cell) for cell in column) for column in columns]
    least = [_longest_word(column) for column in columns]
    while sum(wide) + 2 * (len(wide) - 1) > width:
        slack = [w - n for w, n in zip(wide, least, strict=True)]
        if max(slack) <= 0:
            break
        wide[max(range(len(wide)), key=lambda k: (slack[k] > 0, wide[k]))] -= 1
    wrapped = [
        [_wrapped(cell, w) or [""] for cell, w in zip(row, wide, strict=True)] for row in body
    ]
    if len(columns) >= MANY_COLUMNS and max(len(cell) for row in wrapped for cell in row) > TALLEST:
        yield from _blocks(body, width)
        return
    for number, cells in enumerate(wrapped):
        for k in range(max(map(len, cells))):
            pieces = (cell[k] if k < len(cell) else "" for cell in cells)
            yield "  ".join(p.ljust(w) for p, w in zip(pieces, wide, strict=True)).rstrip()
        if number == 0:
            yield "  ".join("-" * w for w in wide)


def _blocks(body: Sequence[list[str]], width: int) -> Iterator[str]:
    """A table too narrow for its text: a block a row, under its first cell."""
    head, *rows = body
    for row in rows:
        yield row[0]
        for title, cell in zip(head[1:], row[1:], strict=True):
            yield from _wrapped(f"{title}: {cell}", width, "  ", "    ")
        yield ""


def _longest_word(column: Sequence[str]) -> int:
    words = [word for cell in column for word in cell.split()]
    return max([len(word) for word in words] or [0])

"""HTML and SVG by construction: text is escaped unless it is already markup. Knows no report.

Whatever an operator, a bus or a file put into a string, it arrives in the page as text.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

VOID = frozenset({"meta", "br", "col", "link", "hr"})

# Not allowed in HTML or not in UTF-8: control characters but for white space, halves of surrogates.
_FORBIDDEN = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]"
)


class Html(str):
    """Markup; every other string is text."""

    __slots__ = ()


Attribute = str | int | float | bool | None


def text(value: str) -> Html:
    """Return a string as markup: escaped, unless it is markup already."""
    if isinstance(value, Html):
        return value
    return Html(html.escape(_FORBIDDEN.sub("\ufffd", value), quote=True))


def element(tag: str, *children: str, **attributes: Attribute) -> Html:
    """Build one element.

    Attribute names are Python's: ``class_`` is class, ``stroke_width`` is stroke-width. None and False
    leave an attribute out, True gives it no value.
    """
    written = "".join(
        f" {name.rstrip('_').replace('_', '-')}"
        + ("" if value is True else f'="{text(_attribute(value))}"')
        for name, value in attributes.items()
        if value is not None and value is not False
    )
    if tag in VOID:
        if children:
            raise ValueError(f"<{tag}> has no content")
        return Html(f"<{tag}{written}>")
    return Html(f"<{tag}{written}>{join(children)}</{tag}>")


def join(parts: Iterable[str], separator: str = "") -> Html:
    """Put pieces one after another."""
    return Html(text(separator).join(text(part) for part in parts))


def spoken(value: str) -> Html:
    """Return what a person wrote, kept from turning the text around it round (right-to-left marks)."""
    return element("bdi", value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    title, unit
        Its header; the unit in brackets.
    number
        Whether its cells are numbers, aligned to the right.
    group
        Header over neighbouring columns of the same group.
    """

    title: str
    unit: str = ""
    number: bool = True
    group: str = ""


def table(
    caption: str,
    columns: Sequence[Column],
    rows: Iterable[Sequence[str]],
    *,
    class_: str = "",
    row_classes: Sequence[str] = (),
) -> Html:
    """Build a table whose first column heads its rows, inside a region that scrolls sideways."""
    starts = [
        bool(c.group) and c.group != before.group
        for before, c in zip((columns[0], *columns), columns, strict=False)
    ]
    body = []
    for k, row in enumerate(rows):
        if len(row) != len(columns):
            raise ValueError("a row has one cell a column")
        cells = [element("th", row[0], scope="row")]
        cells += [
            element("td", cell, class_=_class(column, starts=start))
            for cell, column, start in zip(row[1:], columns[1:], starts[1:], strict=True)
        ]
        body.append(element("tr", *cells, class_=(row_classes[k] or None) if row_classes else None))
    made = element(
        "table",
        element("caption", element("span", caption)),
        element("thead", *_header(columns)),
        element("tbody", *body),
        class_=class_ or None,
    )
    return element("div", made, class_="scroll", role="region", aria_label=caption, tabindex=0)


def _header(columns: Sequence[Column]) -> list[Html]:
    grouped = any(column.group for column in columns)
    upper: list[Html] = []
    lower: list[Html] = []
    before = ""
    for column in columns:
        unit = element("span", f"[{column.unit}]", class_="unit") if column.unit else ""
        title = join((column.title, " ", unit)) if column.unit else text(column.title)
        alone = grouped and not column.group
        cell = element(
            "th",
            title,
            scope="col",
            class_=_class(column, starts=bool(column.group) and column.group != before),
            rowspan=2 if alone else None,
        )
        if alone or not grouped:
            upper.append(cell)
        else:
            lower.append(cell)
            if column.group != before:
                width = sum(other.group == column.group for other in columns)
                upper.append(
                    element(
                        "th", column.group, scope="colgroup", colspan=width, class_="group start"
                    )
                )
        before = column.group
    return [element("tr", *row) for row in (upper, lower) if row]


def _class(column: Column, *, starts: bool) -> str | None:
    """Numbers to the right; the first column of a group keeps its distance."""
    return " ".join((["n"] if column.number else []) + (["start"] if starts else [])) or None


def _attribute(value: Attribute) -> str:
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return str(value)

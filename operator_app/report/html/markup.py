"""HTML and SVG elements: text is escaped unless it is already markup. And the parts that all sections use.

Strings from operators, buses and files arrive in the page as text.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from operator_app.safe_output import harmless
from operator_app.units.figure import Figure, typeset

if TYPE_CHECKING:
    from operator_app.report.table import Cell, Column, FactTable


VOID = frozenset({"meta", "br", "col", "link", "hr"})

WHITE_SPACE = "\t\n\r"


class Html(str):
    """Markup; every other string is text."""

    __slots__ = ()


Attribute = str | int | float | bool | None


def text(value: str) -> Html:
    """Return a string as markup: escaped, unless it is markup already."""
    if isinstance(value, Html):
        return value
    return Html(html.escape(harmless(value, keep=WHITE_SPACE), quote=True))


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
    """Return what a person wrote, isolated: right-to-left marks do not turn the text around it."""
    return element("bdi", value)


def _attribute(value: Attribute) -> str:
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return str(value)


OPTION = re.compile(r"--[a-z-]+(?: \d[\d,]*)?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One section: anchor, heading, content; a narrow one takes half of the page."""

    ident: str
    title: str
    content: tuple[str, ...]
    narrow: bool = False

    @property
    def html(self) -> Html:
        """The section as an element."""
        heading = element("h2", self.title, id=f"{self.ident}-h")
        return element(
            "section",
            heading,
            *self.content,
            id=self.ident,
            aria_labelledby=f"{self.ident}-h",
            class_="narrow" if self.narrow else "",
        )


def definitions(rows: Iterable[tuple[str, str]]) -> Html:
    """Return a list of terms and their definitions."""
    return element(
        "dl",
        *(part for name, value in rows for part in (element("dt", name), element("dd", value))),
        class_="facts",
    )


def figure(caption: str, drawn: Html) -> Html:
    """Return a plot under its caption."""
    return element("figure", element("figcaption", element("b", caption)), drawn)


def plots(drawn: Iterable[Html]) -> Html:
    """Arrange figures side by side where there is room."""
    return element("div", *drawn, class_="plots")


def remark(*words: str) -> Html:
    """Return a paragraph that explains."""
    return element("p", *(w if isinstance(w, Html) else prose(w) for w in words), class_="muted")


def bullets(points: Iterable[str]) -> Html:
    """Return a list."""
    return element("ul", *(element("li", point) for point in points))


def sentence(words: str) -> str:
    """Return text as a sentence: capital first, full stop last."""
    return words[:1].upper() + words[1:] + ("" if words.endswith(".") else ".")


def prose(words: str) -> Html:
    """Return a sentence in which options of the command line stand out and stay in one piece."""
    parts: list[str] = []
    end = 0
    for found in OPTION.finditer(words):
        parts += [
            typeset(words[end : found.start()]),
            element("code", found.group(), class_="whole"),
        ]
        end = found.end()
    return join([*parts, typeset(words[end:])])


def table_html(table: FactTable) -> Html:
    """Build a table whose first column heads its rows."""
    table = table.whole
    starts = [
        bool(c.group) and c.group != before.group
        for before, c in zip((table.columns[0], *table.columns), table.columns, strict=False)
    ]
    body = []
    for k, row in enumerate(table.rows):
        cells = [element("th", _words(row[0]), scope="row")]
        cells += [
            element("td", _words(cell), class_=_class(column, cell, starts=start))
            for cell, column, start in zip(row[1:], table.columns[1:], starts[1:], strict=True)
        ]
        body.append(element("tr", *cells, class_="out" if k in table.out else None))
    caption = typeset(table.title)
    made = element(
        "table",
        element("caption", element("span", caption)),
        element("thead", *_header(table.columns)),
        element("tbody", *body),
        class_=table.ident,
    )
    return element("div", made, class_="scroll", role="region", aria_label=caption, tabindex=0)


def _words(cell: Cell) -> Html:
    """Return the content of a cell; text of people and devices is isolated (right-to-left marks)."""
    if isinstance(cell, Figure):
        words = text(typeset(cell.shown))
        return element("span", "▲ ", words, class_="warn") if cell.role == "warn" else words
    return element("span", spoken(cell), class_="remark") if len(cell) > 40 else text(cell)


def _header(columns: tuple[Column, ...]) -> list[Html]:
    grouped = any(column.group for column in columns)
    upper: list[Html] = []
    lower: list[Html] = []
    before = ""
    for column in columns:
        unit = element("span", f"[{column.unit}]", class_="unit") if column.unit else ""
        title = join((column.title, " ", unit)) if column.unit else text(column.title)
        alone = grouped and not column.group
        starts = bool(column.group) and column.group != before
        cell = element(
            "th",
            title,
            scope="col",
            class_=_class(column, starts=starts),
            rowspan=2 if alone else None,
        )
        (upper if alone or not grouped else lower).append(cell)
        if starts:
            width = sum(other.group == column.group for other in columns)
            upper.append(
                element("th", column.group, scope="colgroup", colspan=width, class_="group start")
            )
        before = column.group
    return [element("tr", *row) for row in (upper, lower) if row]


def _class(column: Column, cell: Cell = "", *, starts: bool) -> str | None:
    """CSS class of a cell: numbers to the right, a gap before the first column of a group."""
    classes = [] if column.words else ["n"]
    classes += ["start"] if starts else []
    if isinstance(cell, Figure) and cell.role not in ("text", "warn"):
        classes.append(cell.role)
    return " ".join(classes) or None

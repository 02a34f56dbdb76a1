"""HTML and SVG elements, common parts of sections, and the style sheet.

Text is escaped unless it is already markup, so that strings from operators, buses and files cannot add markup.
"""

import html
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from operator_app.report.table import Cell, Column, FactTable
from operator_app.safe_output import sanitized
from operator_app.units import Figure, typeset

VOID = frozenset({"meta", "br", "col", "link", "hr"})

WHITE_SPACE = "\t\n\r"


class Html(str):
    """HTML or SVG markup. Functions of this module insert it unchanged, and escape strings of other types."""

    __slots__ = ()


Attribute = str | int | float | bool | None


def text(value: str) -> Html:
    """Return a string as markup, escaped unless it is already markup."""
    if isinstance(value, Html):
        return value
    return Html(html.escape(sanitized(value, keep=WHITE_SPACE), quote=True))


def element(tag: str, *children: str, **attributes: Attribute) -> Html:
    """Build one element.

    Attribute names follow Python's rules: ``class_`` is class, ``stroke_width`` is stroke-width. An attribute that is
    None or False is left out; an attribute that is True is written without a value.
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


def join(parts: Iterable[str]) -> Html:
    """Return the parts joined as markup; text is escaped."""
    return Html("".join(text(part) for part in parts))


def spoken(value: str) -> Html:
    """Return text from a person as an isolated element, so that its writing direction affects no other text."""
    return element("bdi", value)


def _attribute(value: Attribute) -> str:
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return str(value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One section of the page: anchor, heading, content; a narrow section takes half of the page's width."""

    ident: str
    title: str
    content: tuple[str, ...]
    narrow: bool = False

    @property
    def html(self) -> Html:
        """The section as an element."""
        return element(
            "section",
            element("h2", self.title, id=f"{self.ident}-h"),
            *self.content,
            id=self.ident,
            aria_labelledby=f"{self.ident}-h",
            class_="narrow" if self.narrow else "",
        )


def definitions(rows: Iterable[tuple[str, str]]) -> Html:
    """Return a list of terms and their definitions."""
    parts = (part for name, value in rows for part in (element("dt", name), element("dd", value)))
    return element("dl", *parts, class_="facts")


def plots(drawn: Iterable[Html]) -> Html:
    """Return figures, placed side by side if there is room."""
    return element("div", *drawn, class_="plots")


def remark(*text_parts: str) -> Html:
    """Return an explanatory paragraph."""
    return element("p", *map(typeset, text_parts), class_="muted")


def bullets(points: Iterable[str]) -> Html:
    """Return a bulleted list."""
    return element("ul", *(element("li", point) for point in points))


def sentence(text: str) -> str:
    """Return text as a sentence, with a capital letter and a full stop."""
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def table_html(table: FactTable) -> Html:
    """Return an HTML table whose first column contains the row headers."""
    table = table.whole
    groups = [column.group for column in table.columns]
    starts = [bool(g) and g != before for before, g in zip(["", *groups], groups, strict=False)]
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
        element("thead", *_header(table.columns, starts)),
        element("tbody", *body),
        class_=table.ident,
    )
    return element("div", made, class_="scroll", role="region", aria_label=caption, tabindex=0)


def _words(cell: Cell) -> Html:
    """Return a cell as HTML; text of over 40 characters is isolated, see `spoken`."""
    if isinstance(cell, Figure):
        content = text(typeset(cell.shown))
        return element("span", "▲ ", content, class_="warn") if cell.role == "warn" else content
    return element("span", spoken(cell), class_="remark") if len(cell) > 40 else text(cell)


def _header(columns: tuple[Column, ...], first_of_group: list[bool]) -> list[Html]:
    grouped = any(column.group for column in columns)
    upper: list[Html] = []
    lower: list[Html] = []
    for column, starts in zip(columns, first_of_group, strict=True):
        unit = element("span", f"[{column.unit}]", class_="unit") if column.unit else ""
        title = join((column.title, " ", unit)) if column.unit else text(column.title)
        alone = grouped and not column.group
        class_, rows = _class(column, starts=starts), 2 if alone else None
        cell = element("th", title, scope="col", class_=class_, rowspan=rows)
        (upper if alone or not grouped else lower).append(cell)
        if starts:
            name, width = column.group, sum(other.group == column.group for other in columns)
            class_ = "group start"
            upper.append(element("th", name, scope="colgroup", colspan=width, class_=class_))
    return [element("tr", *row) for row in (upper, lower) if row]


def _class(column: Column, cell: Cell = "", *, starts: bool) -> str | None:
    classes = [] if column.words else ["n"]
    classes += ["start"] if starts else []
    if isinstance(cell, Figure) and cell.role not in ("text", "warn"):
        classes.append(cell.role)
    return " ".join(classes) or None


COLOUR_RULES, PLOT_RULES, PAGE_RULES = (
    Path(__file__).with_name(f"{name}.css").read_text("utf-8")
    for name in ("colours", "plot", "report")
)
"""Style sheets: colours of the light and of the dark theme, content of a picture, page."""
STYLE = COLOUR_RULES + PLOT_RULES + PAGE_RULES
LIGHT_COLOURS, DARK_COLOURS = (
    dict(re.findall(r"--(\w+):([^;]+);", theme)) for theme in COLOUR_RULES.split("@media")
)
"""Colours of each theme, by name."""

"""A table of facts as HTML, with all columns, in a region that scrolls sideways."""

from __future__ import annotations

from typing import TYPE_CHECKING

from operator_app.report.html.markup import Html, element, join, spoken, text
from operator_app.units.figure import Figure
from operator_app.units.numbers import typeset

if TYPE_CHECKING:
    from operator_app.report.table import Cell, Column, FactTable


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

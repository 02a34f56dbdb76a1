"""Tables of facts: figures under headers with units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from operator_app.units import Figure

Cell = Figure | str


def shown(cell: Cell) -> str:
    """Return a cell as text."""
    return cell if isinstance(cell, str) else cell.shown


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table. Its header is the title, followed by the unit in brackets if there is one.

    `words`: whether the cells are text, which is aligned to the left.
    `group`: header above neighbouring columns that belong together.
    `detail`: whether only the HTML page shows the column.
    `summary`: whether the column replaces detail columns in all outputs except the HTML page, which omits it.
    """

    title: str
    unit: str = ""
    words: bool = False
    group: str = ""
    detail: bool = False
    summary: bool = False


def words(*titles: str, detail: bool = False) -> tuple[Column, ...]:
    """Return a column of text for each title."""
    return tuple(Column(title, words=True, detail=detail) for title in titles)


def figures(
    *titles: str, unit: str = "", group: str = "", detail: bool = False
) -> tuple[Column, ...]:
    """Return neighbouring columns of figures."""
    return tuple(Column(title, unit, group=group, detail=detail) for title in titles)


@dataclass(frozen=True, slots=True, kw_only=True)
class FactTable:
    """Rows of facts; `ident` is used in links, `title` is the caption.

    `detail`: only the HTML page shows the table. `out`: indices of rows that are not used, shown dimmed.
    """

    ident: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    detail: bool = False
    out: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError("a row has one cell per column")

    @property
    def brief(self) -> FactTable:
        """The table without columns that only the HTML page has."""
        return self._of([k for k, column in enumerate(self.columns) if not column.detail])

    @property
    def whole(self) -> FactTable:
        """The table with its detail columns, and without the summary columns that replace them in text."""
        return self._of([k for k, column in enumerate(self.columns) if not column.summary])

    def _of(self, rows: list[int]) -> FactTable:
        return replace(
            self,
            columns=tuple(self.columns[k] for k in rows),
            rows=tuple(tuple(row[k] for k in rows) for row in self.rows),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Headline:
    """A figure that summarises a calibration, with name and note. `closure`: whether it is a closure sigma."""

    name: str
    figure: Figure
    note: str = ""
    closure: bool = False

    @property
    def text(self) -> str:
        """Text such as ``rank 14 (of 14)``."""
        return self.figure_text + (f" ({self.note})" if self.note else "")

    @property
    def figure_text(self) -> str:
        """Text such as ``rank 14``."""
        return f"{self.name} {self.figure.with_unit}"


def keyed(tables: Iterable[FactTable]) -> dict[str, Any]:
    """Return all figures that have a `key` as a nested JSON object. An object with only integer keys becomes a list."""
    tree: dict[str | int, Any] = {}
    for figure in (c for t in tables for row in t.rows for c in row if isinstance(c, Figure)):
        if figure.key:
            branch = tree
            for step in figure.key[:-1]:
                branch = branch.setdefault(step, {})
            branch[figure.key[-1]] = figure.in_json
    return {str(name): _with_lists(part) for name, part in tree.items()}


def _with_lists(part: Any) -> Any:
    if not isinstance(part, Mapping):
        return part
    if part and all(isinstance(step, int) for step in part):
        return [_with_lists(part[step]) for step in sorted(part)]
    return {name: _with_lists(inner) for name, inner in part.items()}

"""Figures and tables as facts: each with its quantity, unit, digits and role. Knows no renderer.

A number's unit and digits are decided here, once; text, page and screen show `Figure.shown`, JSON
takes `Figure.in_json` under `Figure.key`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from operator_app.report.numbers import NOT_KNOWN, fixed, significant
from solver.chain.parameters import Parameter

Key = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A unit: how people read it, and `per_si` of it in one SI unit; `json_per_si` is a contract."""

    unit: str
    per_si: float = 1.0
    json_per_si: float = 1.0


ANGLE = Quantity("deg", 180.0 / math.pi, 180.0 / math.pi)
LENGTH = Quantity("mm", 1e3, 1.0)
CLOSURE_ANGLE = Quantity("mrad", 1e3, 1e3)
CLOSURE_LENGTH = Quantity("mm", 1e3, 1e3)
NOISE_ANGLE = Quantity("mdeg", 180e3 / math.pi)
SHARE = Quantity("%", 100.0)
LSB = Quantity("LSB")
NUMBER = Quantity("")


def quantity_of(parameter: Parameter) -> Quantity:
    """Return how a parameter's values are given."""
    return ANGLE if parameter.is_angle else LENGTH


def in_json(parameter: Parameter, value: float) -> float | None:
    """Return a parameter's value in the units of the contract, deg and m; None if it is not finite."""
    return Figure(float(value), quantity_of(parameter)).in_json


@dataclass(frozen=True, slots=True)
class Figure:
    """One number.

    Attributes
    ----------
    value
        SI; None or not finite where it is not known.
    places, digits
        Decimal places, or where these are None significant digits.
    role
        ``text``, ``found`` (what was asked for), ``warn``.
    key
        Where it stands in the JSON object; empty: nowhere.
    """

    value: float | None
    quantity: Quantity = NUMBER
    places: int | None = None
    digits: int = 3
    signed: bool = False
    role: str = "text"
    key: Key = ()

    @property
    def shown(self) -> str:
        """The number as people read it, without its unit."""
        if self.value is None:
            return NOT_KNOWN
        value = self.quantity.per_si * self.value
        if self.places is None:
            return significant(value, self.digits)
        return fixed(value, self.places, signed=self.signed)

    @property
    def with_unit(self) -> str:
        """The number with its unit."""
        return f"{self.shown} {self.quantity.unit}".rstrip()

    @property
    def in_json(self) -> float | None:
        """The number at full precision, in the units of the contract; None where it is not known."""
        if self.value is None or not math.isfinite(self.value):
            return None
        # Counts stay whole.
        return (
            self.value
            if self.quantity.json_per_si == 1.0
            else self.quantity.json_per_si * self.value
        )


Cell = Figure | str


def shown(cell: Cell) -> str:
    """Return a cell as people read it."""
    return cell if isinstance(cell, str) else cell.shown


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    title, unit
        Its header; the unit in brackets.
    words
        Whether its cells are words, aligned to the left.
    group
        Header over neighbouring columns of the same group.
    detail
        Whether there is room for it on the page only.
    summary
        Whether it stands for details, where there is no room for them.
    """

    title: str
    unit: str = ""
    words: bool = False
    group: str = ""
    detail: bool = False
    summary: bool = False


def words(*titles: str) -> tuple[Column, ...]:
    """Return columns of words."""
    return tuple(Column(title, words=True) for title in titles)


def figures(
    *titles: str, unit: str = "", group: str = "", detail: bool = False
) -> tuple[Column, ...]:
    """Return neighbouring columns of figures."""
    return tuple(Column(title, unit, group=group, detail=detail) for title in titles)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows of facts.

    Attributes
    ----------
    ident, title
        Name for links, and caption.
    rows
        One cell a column.
    note
        What to know in order to read it.
    detail
        Whether there is room for it on the page only.
    out
        Rows (indices) that do not count and stand back.
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
            raise ValueError("a row has one cell a column")

    @property
    def brief(self) -> Table:
        """The table without the columns that only the page has room for."""
        return self._of([k for k, column in enumerate(self.columns) if not column.detail])

    @property
    def whole(self) -> Table:
        """The table without the columns that stand for others."""
        return self._of([k for k, column in enumerate(self.columns) if not column.summary])

    def _of(self, kept: list[int]) -> Table:
        return replace(
            self,
            columns=tuple(self.columns[k] for k in kept),
            rows=tuple(tuple(row[k] for k in kept) for row in self.rows),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Headline:
    """A figure that sums a calibration up, and what to hold it against."""

    name: str
    figure: Figure
    note: str = ""

    @property
    def text(self) -> str:
        """``rank 14 (of 14)``."""
        return self.figure_text + (f" ({self.note})" if self.note else "")

    @property
    def figure_text(self) -> str:
        """``rank 14``."""
        return f"{self.name} {self.figure.with_unit}"


def keyed(tables: Iterable[Table]) -> dict[str, Any]:
    """Return all figures that have a key as one object; whole-number keys make lists."""
    tree: dict[str | int, Any] = {}
    for figure in (c for t in tables for row in t.rows for c in row if isinstance(c, Figure)):
        if figure.key:
            here = tree
            for step in figure.key[:-1]:
                here = here.setdefault(step, {})
            here[figure.key[-1]] = figure.in_json
    return {str(name): _with_lists(part) for name, part in tree.items()}


def _with_lists(part: Any) -> Any:
    if not isinstance(part, Mapping):
        return part
    if part and all(isinstance(step, int) for step in part):
        return [_with_lists(part[step]) for step in sorted(part)]
    return {name: _with_lists(inner) for name, inner in part.items()}

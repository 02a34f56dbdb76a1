"""The rows of a poses file: cells to numbers, complaining about each that is none. Knows the header."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from operator_app.config.errors import ConfigError, Problem
from operator_app.config.poses_header import Header
from operator_app.config.quantities import angle_doubt, length_doubt

MOST_PROBLEMS = 100
NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity|#n/a|n/a|na)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One pose as written."""

    placement: int
    label: str
    numbers: dict[str, float]
    samples: int
    utc: str
    note: str


class _Bad(Exception):
    """A cell that cannot be used: text and remedy."""

    def __init__(self, text: str, remedy: str) -> None:
        self.text = text
        self.remedy = remedy
        super().__init__(text)


def read_rows(lines: list[tuple[int, list[str]]], header: Header, file: str) -> list[Row]:
    """Read all rows.

    Raises
    ------
    ConfigError
        With all that is wrong, up to a hundred problems: a file that is wrong all over is one
        mistake, not a thousand.
    """
    if not lines:
        raise ConfigError(
            (Problem(file=file, text="has a header and no poses", remedy="capture poses first"),)
        )
    problems: list[Problem] = []
    rows: list[Row] = []
    first_line: dict[tuple[int, str], int] = {}
    for line, cells in lines:
        row = _read_row(line, cells, header, file, problems)
        if row is not None:
            key = (row.placement, row.label)
            if key in first_line:
                problems.append(
                    Problem(
                        file=file,
                        line=line,
                        column=header.columns.index("pose") + 1,
                        key="pose",
                        text=f"placement {key[0]}, pose {key[1]} is already in line {first_line[key]}",
                        remedy="give every pose of a placement its own name",
                    )
                )
            first_line.setdefault(key, line)
            rows.append(row)
        if len(problems) >= MOST_PROBLEMS:
            stopped = Problem(
                file=file,
                line=line,
                column=len(header.columns) + 1,
                text=f"{len(problems)} problems up to here; the rest of the file was not looked at",
                remedy="correct these first",
            )
            raise ConfigError((*problems, stopped))
    if problems:
        raise ConfigError(problems)
    return rows


def _read_row(
    line: int, cells: list[str], header: Header, file: str, problems: list[Problem]
) -> Row | None:
    count = len(header.columns)
    if len(cells) != count:
        remedy = "write one cell per column"
        if len(cells) > count:
            remedy += "; decimal commas?"
        problems.append(
            Problem(
                file=file,
                line=line,
                text=f"{len(cells)} cells for the {count} columns of the header",
                remedy=remedy,
            )
        )
        return None
    by_name = {name: cell.strip() for name, cell in zip(header.columns, cells, strict=True)}
    numbers: dict[str, float] = {}
    whole: dict[str, int] = {}
    bad = False
    for column, name in enumerate(header.columns, 1):
        try:
            if name in ("placement", "samples"):
                whole[name] = _whole(by_name[name])
            elif name == "pose":
                _label(by_name[name])
            elif name not in ("utc", "note"):
                numbers[name] = _quantity(name, by_name[name])
        except _Bad as error:
            bad = True
            problems.append(
                Problem(
                    file=file,
                    line=line,
                    column=column,
                    key=name,
                    text=error.text,
                    remedy=error.remedy,
                )
            )
    if bad:
        return None
    note_cells = dict(zip(header.columns, cells, strict=True))
    return Row(
        placement=whole["placement"],
        label=by_name["pose"],
        numbers=numbers,
        samples=whole.get("samples", 0),
        utc=by_name.get("utc", ""),
        note=note_cells.get("note", ""),
    )


def _whole(cell: str) -> int:
    value = _number(cell)
    if value != int(value) or not 1 <= value <= 2**53 or "." in cell or "e" in cell.lower():
        raise _Bad(f"{cell} is not a whole number from 1", "correct the number")
    return int(cell)


def _label(cell: str) -> None:
    if not cell:
        raise _Bad("the cell is empty", "give the pose a number or a name")


def _quantity(name: str, cell: str) -> float:
    value = _number(cell)
    doubt = length_doubt(value) if name.endswith("_m") else angle_doubt(value)
    if doubt:
        raise _Bad(doubt, "metres" if name.endswith("_m") else "degrees")
    if name.startswith("sd") and value < 0.0:
        raise _Bad(f"a spread of {cell} deg is negative", "correct the number")
    return value


def _number(cell: str) -> float:
    if not cell:
        raise _Bad("the cell is empty", "fill it in or take the row out")
    if NUMBER.fullmatch(cell):
        value = float(cell)
        if math.isfinite(value):
            return value
    if NOT_FINITE.fullmatch(cell) or NUMBER.fullmatch(cell):
        raise _Bad(
            f"{cell[:40]} is not a finite number", "measure the pose again or take the row out"
        )
    if re.fullmatch(r"[-+]?\d+,\d+", cell):
        raise _Bad(f"{cell[:40]!r} has a decimal comma", "write a decimal point")
    raise _Bad(f"{cell[:40]!r} is not a number", "correct the cell")

"""Strict reading of CSV: records with their line numbers, and problems with line and column."""

import csv
import io
import math
import re
import sys
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, MutableSequence
from typing import Any

from operator_app.config.errors import ConfigError, Problem, only, shortened
from operator_app.safe_output import sanitized
from operator_app.units import MOST_WHOLE

MOST_PROBLEMS = 100
CSV_NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity|#n/a|n/a|na)", re.IGNORECASE)
FORMULA = re.compile(r"'*(?:\s*[=+\-@]|[\t\r\n])")
"""Text that a spreadsheet may read as a formula, also after apostrophes; one more apostrophe prevents this."""
ESCAPED = re.compile(r"(\\+)u\{([0-9a-f]{1,6})\}")
LOOKS_ESCAPED = re.compile(r"(\\+)(u\{[0-9a-f]{1,6}\})")
HIDDEN_CANDIDATE = re.compile(r"(\\*)([^\\])", re.DOTALL)
SHOWN_BLANKS = "\t\n"
"""Characters allowed in a cell in addition to printable ones."""

Record = tuple[int, list[str]]
"""First line of a record, from 1, and its cells."""


class BadCell(Exception):
    """An invalid cell: text and remedy."""

    def __init__(self, text: str, remedy: str) -> None:
        self.text = text
        self.remedy = remedy
        super().__init__(text)


def read_records(text: str, file: str, *, example: str) -> Iterator[Record]:
    """Yield the records of a file, the header first; blank lines are skipped.

    Raises ConfigError if the file is empty or not CSV with commas. `example`: remedy for an empty file.
    """
    first = next((line for line in io.StringIO(text, newline=None) if line.strip()), "")
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in first and "," not in first:
            remedy = "save the file with commas between columns and points as decimal marks"
            raise only(file, f"the columns are separated by {name}", remedy, line=1)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    start, empty = 1, True
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells) or len(cells) > 1:
                empty = False
                yield start, cells
            start = reader.line_num + 1
    except csv.Error as error:
        remedy = "check the quotes in this line"
        raise only(file, f"is not CSV: {error}", remedy, line=start) from error
    if empty:
        raise only(file, "is empty", example)


def read_columns(
    records: Iterable[Record],
    columns: Mapping[str, Callable[[str], Any]],
    file: str,
    *,
    packed: Collection[str],
    unique: tuple[str, ...],
    unique_remedy: str,
) -> dict[str, MutableSequence[Any]]:
    """Return the values of each column, by name and in the order of the rows, from all records below the header.

    `columns`: name of each column of the file, in order, and the function that reads its cells or raises `BadCell`.
    `packed`: columns stored as 8-byte floats, a quarter of the memory of Python objects. `unique`: columns whose values
    together must differ between rows, or `unique_remedy` is shown. Raises ConfigError with up to a hundred problems.
    """
    problems: list[Problem] = []
    values_by_name: dict[str, MutableSequence[Any]] = {
        name: array("d") if name in packed else [] for name in columns
    }
    first_line: dict[tuple[Any, ...], int] = {}

    def complain(line: int, name: str, text: str, remedy: str) -> None:
        column = list(columns).index(name) + 1
        problems.append(
            Problem(file=file, line=line, column=column, key=name, text=text, remedy=remedy)
        )

    for line, cells in records:
        row: dict[str, Any] = {}
        if len(cells) == len(columns):
            for (name, read), cell in zip(columns.items(), cells, strict=True):
                try:
                    row[name] = read(cell)
                except BadCell as error:
                    complain(line, name, error.text, error.remedy)
        else:
            commas = "; check for decimal commas" if len(cells) > len(columns) else ""
            text = f"{len(cells)} cells for the {len(columns)} columns of the header"
            remedy = f"write one cell per column{commas}"
            problems.append(Problem(file=file, line=line, text=text, remedy=remedy))
        if len(row) == len(columns):
            key = tuple(row[name] for name in unique)
            if key in first_line:
                which = ", ".join(f"{name} {row[name]}" for name in unique)
                text = f"{which} is already in line {first_line[key]}"
                complain(line, unique[-1], text, unique_remedy)
            first_line.setdefault(key, line)
            for name, values in values_by_name.items():
                values.append(row[name])
        if len(problems) >= MOST_PROBLEMS:
            text = f"{len(problems)} problems up to here; the rest of the file was not read"
            last, remedy = len(columns) + 1, "correct these first"
            problems.append(Problem(file=file, line=line, column=last, text=text, remedy=remedy))
            break
    if problems:
        raise ConfigError(problems)
    return values_by_name


def number(cell: str) -> float:
    """Read a finite decimal number; raises BadCell."""
    cell = cell.strip()
    if not cell:
        raise BadCell("the cell is empty", "fill it in or remove the row")
    if CSV_NUMBER.fullmatch(cell) and math.isfinite(float(cell)):
        return float(cell)
    shown = shortened(cell)
    if NOT_FINITE.fullmatch(cell) or CSV_NUMBER.fullmatch(cell):
        raise BadCell(f"{shown} is not a finite number", "measure the pose again or remove the row")
    if re.fullmatch(r"[-+]?\d+,\d+", cell):
        raise BadCell(f"{shown!r} has a decimal comma", "write a decimal point")
    raise BadCell(f"{shown!r} is not a number", "correct the cell")


def whole_number(cell: str) -> int:
    """Read a whole number of at least 1; raises BadCell."""
    value, shown = number(cell), shortened(cell.strip())
    plain = not any(c in cell for c in ".eE")
    if plain and (value > MOST_WHOLE or int(cell) > MOST_WHOLE):
        raise BadCell(f"{shown} is too large", f"use a whole number of at most {MOST_WHOLE}")
    if not plain or value < 1:
        raise BadCell(f"{shown} is not a whole number of at least 1", "correct the number")
    return int(cell)


def write_records(records: Iterable[Iterable[str]], *, texts: Collection[str] = ()) -> bytes:
    """Format records as CSV, the header first, so that `read_records` returns the same cells.

    Cells of the columns named in `texts` are free text: they are written so that no spreadsheet reads them as a
    formula and no terminal interprets them; `text_of` returns the original text.
    """
    rows = iter(records)
    header = list(next(rows))
    lines = [",".join(map(_quoted, header))]
    for cells in rows:
        pairs = zip(header, cells, strict=True)
        lines.append(",".join(_quoted(_as_text(c) if name in texts else c) for name, c in pairs))
    return ("\n".join(lines) + "\n").encode("utf-8")


def text_of(cell: str) -> str:
    """Return the original text of a cell written by `write_records`."""
    text = cell[1:] if cell.startswith("'") and FORMULA.match(cell) else cell
    return ESCAPED.sub(_unescaped, text)


def _as_text(text: str) -> str:
    # Backslashes before an escape are doubled, so that text that looks like an escape is unchanged.
    safe = LOOKS_ESCAPED.sub(r"\1\1\2", text)
    if sanitized(safe, keep=SHOWN_BLANKS) != safe:
        safe = HIDDEN_CANDIDATE.sub(_escaped, safe)
    return f"'{safe}" if FORMULA.match(safe) else safe


def _escaped(match: re.Match[str]) -> str:
    before, character = match.groups()
    if sanitized(character, keep=SHOWN_BLANKS) == character:
        return match[0]
    return f"{before}{before}\\u{{{ord(character):x}}}"


def _unescaped(match: re.Match[str]) -> str:
    before, code = match.groups()
    half = before[: len(before) // 2]
    if len(before) % 2 == 0:
        return f"{half}u{{{code}}}"
    character = chr(int(code, 16)) if int(code, 16) <= sys.maxunicode else ""
    shown = sanitized(character, keep=SHOWN_BLANKS) == character
    return match[0] if shown else f"{half}{character}"


def _quoted(cell: str) -> str:
    # Python's csv.writer leaves a lone carriage return unquoted, which ends the line for readers.
    if any(c in cell for c in ',"\r\n'):
        return '"' + cell.replace('"', '""') + '"'
    return cell

"""Reads joint logs of robots: rows of numbers, with a header or without, in radians or degrees.

Numbers are separated by commas or white space; lines that begin with ``#`` are comments.
"""

import math
import re
from array import array
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from operator_app.config import poses_file
from operator_app.config.csv_table import MOST_PROBLEMS, BadCell, Record, number
from operator_app.config.errors import ConfigError, Problem, decode_text, only
from operator_app.config.measured_endpoints import endpoint_columns, endpoints_of
from operator_app.config.quantities import angle_doubt
from operator_app.config.resources import expanded, read_limited
from solver.arrays import FloatArray
from solver.chain.poses import PoseSet

Unit = Literal["rad", "deg"]
WHOLE = re.compile(r"[1-9]\d{0,3}")
MOST_LOGGED_PLACEMENTS = 100
NUMBERED_JOINT = re.compile(r"(.*\D|)(\d+)(\D*)")
OTHER_COLUMNS = re.compile(r"t|time.*|.*stamp.*|n?secs?|index|row|pose|label", re.IGNORECASE)
"""Names of columns in a log that are not joints."""

RANGE = re.compile(r"([1-9]\d{0,3})-([1-9]\d{0,3})")
SPLIT_AT_DECIMAL_COMMAS = re.compile(r"\d+\s*[;\s]\s*[-+]?\d+")
"""Matches a cell of a file split at decimal commas: decimals, a separator, the whole part of the next number."""


def load_joint_log(
    path: str | Path,
    *,
    joint_count: int,
    unit: Unit | None = None,
    columns: str = "",
    placement: str = "",
    joints: Sequence[str] = (),
    instrument: bool = False,
) -> poses_file.LoadedPoses:
    """Read the poses of a log, or of a poses file; raises ConfigError with all problems of the file.

    Parameters
    ----------
    unit
        Unit of the angles. If None, the header states the unit (``q1_rad``), or else the unit is degrees. In this case,
        angles are refused if they look like radians and the header does not state radians.
    columns
        Columns of joints 1 to n, in this order, by number from 1 (``2-8``, ``3,1,2``) or by name. If empty, these are
        the columns with the names `joints`, or else with numbered names, or else all columns without another meaning.
    placement
        Number or name of the column with the fixture's placement at each pose. Placements are whole numbers or names.
        Names are numbered in order of appearance. If `placement` is empty, all poses have the same placement.
    instrument
        Whether the log must have columns of measured endpoints.
    """
    data, file = read_limited(expanded(path), str(path), limit=poses_file.LIMIT_BYTES), str(path)
    rows = read_rows(decode_text(data, file))
    if not rows:
        raise only(file, "is empty", "it must have a row of joint angles for each pose")
    _require_marks(rows[:2], file)
    line, first = rows[0]
    # A row of a log may begin with the name of its placement.
    header = first if not any(map(is_number, first if placement else first[:1])) else []
    if header and not columns and any(poses_file.THETA.fullmatch(cell) for cell in header):
        unit_of(["theta1_deg"], unit, file, line)
        if placement:
            remedy = "leave --placement out: such a file has a column placement"
            raise only(file, "is a poses file", remedy, line=line)
        return poses_file.parse_poses(data, file, joint_count=joint_count)
    body = rows[1:] if header else rows
    if not body:
        raise only(file, "has a header but no poses", "capture poses first")
    width = len(body[0][1])
    if header and len(header) != width:
        raise wrong_header(header, width, file, line)
    by = find_column("--placement", placement, header, width, file) if placement else None
    measured = endpoint_columns(header, file, line, needed=instrument)
    remaining = [k for k in range(width) if k != by and not (header and header[k] in measured)]
    where = find_columns(columns, header, remaining, joint_count, body, file, joints)
    used = unit
    if header and not (columns and unit):
        used = unit_of([header[k] for k in where], unit, file, line)
    columns_of_joints = [(k, f"joint {j}", number) for j, k in enumerate(where, 1)]
    of_endpoint = [(header.index(name), name, number) for name in measured]
    table = read_numbers(body, [*columns_of_joints, *of_endpoint], file)
    q, ends = table[:, : len(where)], table[:, len(where) :]
    _require_plausible(q, body, file, radians=used == "rad")
    if unit is None and len(q) >= poses_file.FEWEST_POSES_FOR_UNIT:
        require_degrees(np.abs(q).max(), f"{len(q)} poses", file, stated=used)
    numbers, notes = ([1] * len(q), None) if by is None else _placements(body, by, file)
    lines = [line for line, _ in body]
    poses = PoseSet(
        placement=np.array(numbers, dtype=np.int64),
        label=tuple(str(k) for k in range(1, len(q) + 1)),
        q_rad=q if used == "rad" else np.deg2rad(q),
        notes=notes,
        endpoint=endpoints_of(measured, ends, file, lines) if measured else None,
    )
    return poses_file.LoadedPoses(poses=poses, warnings=())


def wrong_header(header: list[str], width: int, file: str, line: int) -> ConfigError:
    """Return the error for a header that has more or fewer cells than the first row of angles, which has `width`."""
    text = f"the header has {len(header)} cells, but the first row of angles has {width}"
    return only(file, text, "name each column, or remove the header", line=line)


def unit_of(names: Sequence[str], unit: Unit | None, file: str, line: int) -> Unit | None:
    """Return the unit at the end of every column name in `names` (``_deg``, ``_rad``), or else the user's `unit`.

    Raises ConfigError if the names end with both units, or with another unit than the user's choice.
    """
    endings = {name.casefold().rpartition("_")[2] for name in names}
    stated: Unit | None = "rad" if endings == {"rad"} else "deg" if endings == {"deg"} else None
    if endings == {"rad", "deg"}:
        raise only(file, "the header states degrees and radians", "convert to one", line=line)
    if stated and unit and stated != unit:
        text = f"the header states {'radians' if stated == 'rad' else 'degrees'}"
        remedy = f"leave --{unit} out, or name the columns with --columns if the header is wrong"
        raise only(file, text, remedy, line=line)
    return stated or unit


def require_degrees(largest: float, count: str, file: str, *, stated: Unit | None) -> None:
    """Raise ConfigError if angles may be in radians, because `largest` is below 2 pi and `stated` is not ``rad``.

    `count`: text for the message, such as "40 poses". `stated`: unit in the header; None if the header states none.
    """
    if largest < 2.0 * np.pi and stated != "rad":
        text = f"does not state the unit of its angles, and none in {count} exceeds {largest:.3g}"
        remedy = "use --rad, or --deg if these are degrees"
        if stated:
            text = f"states degrees in its header, but no angle in {count} exceeds {largest:.3g}"
            remedy = "use --deg if these are degrees, or correct the header"
        raise only(file, text, remedy)


def read_numbers(
    body: list[Record], readers: Sequence[tuple[int, str, Callable[[str], float]]], file: str
) -> FloatArray:
    """Return the numbers (m, k) in k columns of a log; raises ConfigError with all problems, up to a hundred.

    `readers`: for each column, index from 0, name in messages, and a function that reads a cell or raises `BadCell`.
    """
    problems: list[Problem] = []
    values, width = array("d"), len(body[0][1])
    for line, cells in body:
        if len(cells) != width:
            text = f"has {len(cells)} cells; the lines before it have {width}"
            problems += only(file, text, "correct this line", line=line).problems
            continue
        for column, key, read in readers:
            try:
                values.append(read(cells[column]))
            except BadCell as error:
                place = Problem(file=file, line=line, column=column + 1, key=key, text=error.text)
                problems.append(replace(place, remedy=error.remedy))
        if len(problems) >= MOST_PROBLEMS:
            break
    if problems:
        raise ConfigError(problems)
    return np.array(values).reshape(-1, len(readers))


def _require_plausible(q: FloatArray, body: list[Record], file: str, *, radians: bool) -> None:
    """Raise ConfigError if an angle in `q` (m, n), rad or deg, exceeds ten turns: it is probably in counts."""
    row, joint = np.unravel_index(np.argmax(np.abs(q)), q.shape)
    value, remedy = float(q[row, joint]), "give degrees"
    text = angle_doubt(math.degrees(value) if radians else value)
    if radians:
        remedy = "if the log is in degrees, leave out --rad or correct the header"
    if text:
        shown = f"joint {joint + 1}: {f'{value:g} rad = ' if radians else ''}{text}"
        raise only(file, shown, remedy, line=body[row][0])


def _placements(body: list[Record], by: int, file: str) -> tuple[list[int], tuple[str, ...] | None]:
    """Return each row's placement number, and a note with its name; no notes (None) if column `by` has numbers."""
    names = [cells[by] for _, cells in body]
    if "" in names:
        line, remedy = body[names.index("")][0], "give the placement a number or a name"
        raise only(file, f"column {by + 1} is empty", remedy, line=line)
    if all(WHOLE.fullmatch(name) for name in names):
        return [int(name) for name in names], None
    order = {name: k for k, name in enumerate(dict.fromkeys(names), 1)}
    if len(order) > MOST_LOGGED_PLACEMENTS:
        text = f"column {by + 1} has {len(order)} different entries"
        remedy = "--placement names a column with the same entry in every pose of a placement"
        raise only(file, text, remedy)
    return [order[name] for name in names], tuple(f"placement {name}" for name in names)


def read_rows(text: str) -> list[Record]:
    """Split lines into cells: at commas if the line has any, otherwise at white space."""
    rows = []
    for line, line_text in enumerate(text.splitlines(), 1):
        if line_text.strip() and not line_text.lstrip().startswith("#"):
            cells = line_text.split(",") if "," in line_text else line_text.split()
            rows.append((line, [cell.strip().strip('"') for cell in cells]))
    return rows


def _require_marks(rows: list[Record], file: str) -> None:
    remedy = "save the file with commas between columns and points as decimal marks"
    for line, cells in rows:
        if len(cells) > 2 and all(map(SPLIT_AT_DECIMAL_COMMAS.fullmatch, cells[1:-1])):
            raise only(file, "the numbers have decimal commas", remedy, line=line)
        if any(";" in cell for cell in cells):
            raise only(file, "the columns are separated by semicolons", remedy, line=line)


def is_number(cell: str) -> bool:
    """Whether a cell is a finite number."""
    try:
        number(cell)
    except BadCell:
        return False
    return True


def find_column(option: str, word: str, header: list[str], count: int, file: str) -> int:
    """Return the index (from 0) of the column `word`, which is a name or a number from 1.

    Raises ConfigError, which mentions `option`, if the file has no such column or several. `count`: number of columns.
    """
    if header.count(word) > 1:
        text = f"{option}: the header has {header.count(word)} columns {word!r}"
        raise only(file, text, f"give the number of the column, e.g. {header.index(word) + 1}")
    if word in header:
        return header.index(word)
    if not re.fullmatch(r"[1-9]\d{0,3}", word):
        known = f"the header has {', '.join(header)}" if header else "the file has no header"
        raise only(file, f"{option}: there is no column {word!r}", known)
    if int(word) > count:
        raise only(file, f"{option}: there is no column {word}", f"the file has {count}")
    return int(word) - 1


def find_columns(
    option: str,
    header: list[str],
    remaining: list[int],
    joint_count: int,
    body: list[Record],
    file: str,
    joints: Sequence[str] = (),
) -> tuple[int, ...]:
    """Return the column indices (from 0) of joints 1 to n, which `option` (``--columns``) lists.

    If `option` is empty, the columns are found among the indices `remaining` by the names `joints`, by numbered names,
    or as the only n columns. `body`: rows below the header. Raises ConfigError if the columns are not found.
    """
    count = len(body[0][1])
    if not option:
        named = [header[k] for k in remaining] if header else []
        if order := joint_order(named, joints, joint_count):
            return tuple(remaining[k] for k in order)
        if len(remaining) == joint_count:
            return tuple(remaining)
        names = f" ({', '.join(named)})" if header else ""
        text = f"{len(remaining)} columns{names} for an arm of {joint_count} joints"
        first = remaining[0] + 1 if remaining else 1
        if len(remaining) > joint_count and _is_time(named[:1], body, remaining[0]):
            first += 1
        example = f"{first}-{first + joint_count - 1}"
        likely = [name for name in named if not OTHER_COLUMNS.fullmatch(name)][:joint_count]
        example = ",".join(likely) if len(likely) == joint_count else example
        remedy = (
            f"select the columns of the joints, e.g. --columns {example}, or write a header: "
            f"{poses_file.HEADER_COLUMNS}"
        )
        raise only(file, text, remedy)
    columns: list[int] = []
    for word in (part.strip() for part in option.split(",")):
        if match := RANGE.fullmatch(word):
            columns += range(int(match[1]) - 1, int(match[2]))
        else:
            columns.append(find_column("--columns", word, header, count, file))
    if over := [k for k in columns if k >= count]:
        text = f"--columns: there is no column {over[0] + 1}"
        raise only(file, text, f"the file has {count}")
    if taken := [k + 1 for k in columns if k not in remaining]:
        text = f"--columns: column {taken[0]} has the times, the placement or a measured endpoint"
        raise only(file, text, "name the columns of the joints")
    if len(columns) != joint_count or len(set(columns)) != len(columns):
        text = f"--columns names {len(set(columns))} columns for an arm of {joint_count} joints"
        raise only(file, text, "name one for each joint, in the order of the joints")
    return tuple(columns)


def _is_time(name: Sequence[str], body: list[Record], column: int) -> bool:
    if name:
        return OTHER_COLUMNS.fullmatch(name[0]) is not None
    values = [
        float(cells[column]) for _, cells in body if is_number("".join(cells[column : column + 1]))
    ]
    return len(values) > 1 and all(a < b for a, b in pairwise(values))


def joint_order(names: Sequence[str], joints: Sequence[str], count: int) -> tuple[int, ...]:
    """Return the indices in `names` of joints 1 to `count`; empty if the joints cannot be recognised.

    If `names` has each of `joints` exactly once, these are the joints. Otherwise, `names` must have exactly one series
    of `count` names that differ just in a number, counted from 0 or 1 (`q1` .. `q7`). If the search for this series
    fails, a second search ignores upper and lower case (`Q1`, `q2` .. `q7`).
    """
    if len(set(joints)) == count and all(names.count(joint) == 1 for joint in joints):
        return tuple(names.index(joint) for joint in joints)
    numberings = [*range(count)], [*range(1, count + 1)]
    for spelled in (names, [name.casefold() for name in names]):
        by_pattern: dict[tuple[str, str], list[tuple[float, int]]] = defaultdict(list)
        for k, name in enumerate(spelled):
            if match := NUMBERED_JOINT.fullmatch(name):
                # Not int, which refuses thousands of digits.
                by_pattern[match[1], match[3]].append((float(match[2]), k))
        complete = [s for s in by_pattern.values() if sorted(n for n, _ in s) in numberings]
        if len(complete) == 1:
            return tuple(k for _, k in sorted(complete[0]))
    return ()

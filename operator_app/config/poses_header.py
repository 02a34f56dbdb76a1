"""The header of a poses file: which columns there are, and what is wrong with them. Knows no rows."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from dataclasses import dataclass

from operator_app.config.errors import ConfigError, Problem

POSITION = ("x_m", "y_m", "z_m")
ROTATION = ("rx_deg", "ry_deg", "rz_deg")
OPTIONAL = ("samples", "utc", "note")
THETA = re.compile(r"theta([1-9][0-9]{0,2})_deg")
SD = re.compile(r"sd([1-9][0-9]{0,2})_deg")
EXAMPLE = "the header is placement,pose,theta1_deg,theta2_deg,..."


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """Columns of a poses file.

    Attributes
    ----------
    columns
        All names, in the order of the file.
    theta, sd, position, rotation
        Names of the columns of each group in joint (or axis) order; empty where absent.
    samples, utc, note
        Whether there is such a column.
    """

    columns: tuple[str, ...]
    theta: tuple[str, ...]
    sd: tuple[str, ...]
    position: tuple[str, ...]
    rotation: tuple[str, ...]
    samples: bool
    utc: bool
    note: bool


def header_names(
    joint_count: int, *, sd: bool, samples: bool, utc: bool, note: bool, endpoint: int
) -> list[str]:
    """Column names in the order in which files are written."""
    joints = range(1, joint_count + 1)
    names = ["placement", "pose", *(f"theta{j}_deg" for j in joints)]
    if sd:
        names += [f"sd{j}_deg" for j in joints]
    present = {"samples": samples, "utc": utc, "note": note}
    names += [name for name in OPTIONAL if present[name]]
    return names + list((POSITION + ROTATION)[:endpoint])


def read_header(cells: list[str], file: str, *, line: int, joint_count: int | None) -> Header:
    """Understand a header line.

    Raises
    ------
    ConfigError
        With all that is wrong with it.
    """
    names = tuple(cell.strip() for cell in cells)
    if not any(_known(name) for name in names):
        raise ConfigError(
            (
                Problem(
                    file=file,
                    line=line,
                    text="this line is no header of a poses file",
                    remedy=EXAMPLE,
                ),
            )
        )
    joints = sorted({int(m[1]) for name in names if (m := THETA.fullmatch(name))})
    last = joint_count if joint_count is not None else (joints[-1] if joints else 1)
    problems = [
        Problem(file=file, line=line, column=column, key=key, text=text, remedy=remedy)
        for column, key, text, remedy in _complaints(names, joints, last, joint_count)
    ]
    if problems:
        raise ConfigError(problems)
    theta = tuple(f"theta{j}_deg" for j in range(1, last + 1))
    sd = tuple(f"sd{j}_deg" for j in range(1, last + 1))
    return Header(
        columns=names,
        theta=theta,
        sd=sd if sd[0] in names else (),
        position=POSITION if POSITION[0] in names else (),
        rotation=ROTATION if ROTATION[0] in names else (),
        samples="samples" in names,
        utc="utc" in names,
        note="note" in names,
    )


Complaint = tuple[int | None, str, str, str]
"""Column from 1 (None where there is none), name, text, remedy."""


def _complaints(
    names: tuple[str, ...], joints: list[int], last: int, joint_count: int | None
) -> Iterator[Complaint]:
    # Columns that a misspelt one was probably meant to be: not missing as well.
    meant: set[str] = set()
    yield from _odd_columns(names, last, meant)
    there = {*names, *meant}
    yield from _missing_columns(there, joints, last, joint_count)
    yield from _surplus_joints(names, joints, joint_count)
    yield from _incomplete_spreads(names, there, last)
    yield from _incomplete_endpoint(there)


def _odd_columns(names: tuple[str, ...], last: int, meant: set[str]) -> Iterator[Complaint]:
    for k, name in enumerate(names):
        if name and name in names[:k]:
            first = names.index(name) + 1
            text = f"this column is given twice (columns {first} and {k + 1})"
            yield k + 1, name, text, "keep one of them"
        elif not _known(name):
            candidates = [c for c in _candidates(last) if c not in names]
            text, remedy, instead = _unknown(name, candidates)
            meant.add(instead)
            yield k + 1, name or f"column {k + 1}", text, remedy


def _missing_columns(
    there: set[str], joints: list[int], last: int, joint_count: int | None
) -> Iterator[Complaint]:
    for name in ("placement", "pose"):
        if name not in there:
            yield None, name, "this column is missing", EXAMPLE
    have = f"{len(joints)} joint column{'s' if len(joints) != 1 else ''}"
    arm = f", the arm has {joint_count} joints" if joint_count is not None else ""
    for j in range(1, last + 1):
        if f"theta{j}_deg" not in there:
            text = f"this column is missing ({have}{arm})"
            yield None, f"theta{j}_deg", text, f"add theta{j}_deg"


def _surplus_joints(
    names: tuple[str, ...], joints: list[int], joint_count: int | None
) -> Iterator[Complaint]:
    for j in joints:
        if joint_count is not None and j > joint_count:
            name = f"theta{j}_deg"
            text = f"the arm has {joint_count} joints"
            yield names.index(name) + 1, name, text, "is it the right arm?"


def _incomplete_spreads(names: tuple[str, ...], there: set[str], last: int) -> Iterator[Complaint]:
    wanted = {f"sd{j}_deg" for j in range(1, last + 1)}
    remedy = "give one for every joint, or none"
    given = {name for name in names if SD.fullmatch(name)}
    for name in sorted(given - wanted):
        yield names.index(name) + 1, name, "there is no such joint", remedy
    for name in sorted(wanted - there) if wanted & there else ():
        yield None, name, "this column is missing", remedy


def _incomplete_endpoint(there: set[str]) -> Iterator[Complaint]:
    wanted = set()
    if there & {*POSITION, *ROTATION}:
        wanted |= set(POSITION)
    if there & set(ROTATION):
        wanted |= set(ROTATION)
    for name in (*POSITION, *ROTATION):
        if name in wanted - there:
            text = "an endpoint is x_m,y_m,z_m, or that and rx_deg,ry_deg,rz_deg"
            yield None, name, "this column is missing", text


def _known(name: str) -> bool:
    return (
        name in ("placement", "pose", *OPTIONAL, *POSITION, *ROTATION)
        or THETA.fullmatch(name) is not None
        or SD.fullmatch(name) is not None
    )


def _candidates(last: int) -> list[str]:
    joints = range(1, last + 1)
    return [
        "placement",
        "pose",
        *(f"theta{j}_deg" for j in joints),
        *(f"sd{j}_deg" for j in joints),
        *OPTIONAL,
        *POSITION,
        *ROTATION,
    ]


def _unknown(name: str, candidates: list[str]) -> tuple[str, str, str]:
    """Text, remedy and the column that was probably meant."""
    if not name:
        return "this column has no name", "name it or take it out", ""
    stem, _, unit = name.rpartition("_")
    for candidate in candidates:
        if unit in ("rad", "m", "mm", "deg", "mrad") and candidate.rpartition("_")[0] == stem:
            right = "degrees" if candidate.endswith("_deg") else "metres"
            return (
                "unknown column",
                f"angles are in degrees, lengths in metres: give {right} and call it {candidate}",
                candidate,
            )
    near = difflib.get_close_matches(name, candidates, n=1, cutoff=0.75)
    if near:
        return "unknown column", f"did you mean {near[0]}?", near[0]
    return "unknown column", "take it out, or put the text into note", ""

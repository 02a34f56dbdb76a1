"""The poses file (CSV): ``placement,pose,theta1_deg..thetaN_deg`` and optional columns.

Angles in the file are degrees and are read with ``np.deg2rad``; lengths are metres. Optional columns are
``sd<j>_deg``, ``samples``, ``utc``, ``note``, ``x_m,y_m,z_m`` and ``rx_deg,ry_deg,rz_deg`` (a rotation vector; for
other orientations and three targets see `measured_endpoints`). The columns may be in any order.
"""

import difflib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from operator_app.config import csv_table
from operator_app.config.atomic import write_atomically
from operator_app.config.errors import ConfigError, Problem, decode_text, only
from operator_app.config.measured_endpoints import (
    POSITION_COLUMNS,
    QUATERNION,
    ROLL_PITCH_YAW,
    ROTATION,
    TARGETS,
    QuaternionError,
    group_of,
    groups_in,
    poses_of_targets,
    rotation_vectors,
)
from operator_app.config.quantities import UNIT, angle_doubt, degrees_for_file, length_doubt
from operator_app.config.resources import expanded, read_limited
from operator_app.units import plural
from solver.arrays import FloatArray
from solver.chain.poses import PoseSet

LIMIT_BYTES = 32 * 1024 * 1024
"""Largest size of a poses file; 100,000 poses of seven joints with standard deviations need some 20 MB."""

BAG_SUFFIXES = (".mcap", ".db3")
FEWEST_POSES_FOR_UNIT = 5
"""The unit of the angles is checked only if a file has at least this many poses."""

KEY = ("placement", "pose")
OPTIONAL = ("samples", "utc", "note")
TEXTS = ("pose", "utc", "note")
THETA = re.compile(r"theta([1-9][0-9]{0,2})_deg")
SD = re.compile(r"sd([1-9][0-9]{0,2})_deg")
NUMBERED = re.compile(r"(\D*)(\d{1,15})", re.ASCII)
"""A label that is a number, or ends in one: `12`, `pose 12`."""
HEADER_COLUMNS = "placement,pose,theta1_deg,theta2_deg,..."
HEADER_EXAMPLE = f"the header is {HEADER_COLUMNS}"
SPREAD_COLUMNS = "give a standard deviation for every joint (sd1_deg, sd2_deg, ...), or for none"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileWarning:
    """A possible mistake in a file."""

    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedPoses:
    """Poses as read, with warnings."""

    poses: PoseSet
    warnings: tuple[FileWarning, ...]


def load_poses(path: str | Path, *, joint_count: int | None = None) -> LoadedPoses:
    """Read a poses file; raises the same errors as `parse_poses`."""
    if str(path).endswith(BAG_SUFFIXES):
        raise only(str(path), "is a ROS 2 bag", "sarcal import makes poses of it")
    data = read_limited(expanded(path), str(path), limit=LIMIT_BYTES)
    return parse_poses(data, str(path), joint_count=joint_count)


def parse_poses(data: bytes, file: str, *, joint_count: int | None = None) -> LoadedPoses:
    """Read poses from the bytes of a CSV file; `joint_count`: joints of the arm, or None for any number.

    Raises ConfigError with up to a hundred problems of the file.
    """
    records = csv_table.read_records(decode_text(data, file), file, example=HEADER_EXAMPLE)
    line, header = next(records)
    names = tuple(cell.strip() for cell in header)
    if not any(map(_known, names)):
        remedy = f"{HEADER_EXAMPLE}; to import a raw log: sarcal import {file}"
        raise only(file, "this line is not the header of a poses file", remedy, line=line)
    if complaints := list(_complaints(names, joint_count)):
        raise ConfigError(
            Problem(file=file, line=line, column=column, key=key, text=text, remedy=remedy)
            for column, key, text, remedy in complaints
        )
    columns = csv_table.read_columns(
        records,
        {name: _reader(name) for name in names},
        file,
        packed=[name for name in names if name not in (*KEY, *OPTIONAL)],
        unique=KEY,
        unique_remedy="give every pose of a placement its own name",
    )
    if not columns["pose"]:
        raise only(file, "has a header but no poses", "capture poses first")
    try:
        poses = _pose_set(_sorted_by_number(columns))
    except ValueError as error:
        remedy = "correct the endpoint's columns, or measure that pose again"
        raise only(file, str(error), remedy) from error
    return LoadedPoses(poses=poses, warnings=tuple(pose_warnings(poses, file)))


def format_poses(poses: PoseSet) -> bytes:
    """Format poses as CSV; each number has enough digits that reading it back gives the same double."""
    joints = range(1, poses.joint_count + 1)
    columns: dict[str, Any] = {"placement": poses.placement.tolist(), "pose": poses.label}

    def add(names: Iterable[str], table: FloatArray) -> None:
        columns.update(zip(names, table.T.tolist(), strict=True))

    add((f"theta{j}_deg" for j in joints), degrees_for_file(poses.q_rad))
    if poses.sd_rad is not None:
        add((f"sd{j}_deg" for j in joints), degrees_for_file(poses.sd_rad))
    if poses.samples is not None:
        columns["samples"] = poses.samples.tolist()
    columns |= {"utc": poses.utc} if poses.utc is not None else {}
    columns |= {"note": poses.notes} if poses.notes is not None else {}
    if poses.endpoint is not None:
        add(POSITION_COLUMNS, poses.endpoint[:, :3])
        if poses.endpoint.shape[1] == 6:
            add(ROTATION, degrees_for_file(poses.endpoint[:, 3:]))
    rows = (map(str, row) for row in zip(*columns.values(), strict=True))
    return csv_table.write_records([columns, *rows], texts=TEXTS)


def save_poses(path: Path, poses: PoseSet) -> None:
    """Write a poses file atomically; raises WriteError if the system refuses."""
    write_atomically(path, format_poses(poses))


Complaint = tuple[int | None, str, str, str]
"""Problem of the header: number of the column from 1 (None if it is missing), its name, text, remedy."""


def _complaints(names: tuple[str, ...], joint_count: int | None) -> Iterator[Complaint]:
    joints = {int(m[1]) for name in names if (m := THETA.fullmatch(name))}
    last = joint_count if joint_count is not None else max(joints, default=1)
    theta, sd = ([f"{kind}{j}_deg" for j in range(1, last + 1)] for kind in ("theta", "sd"))
    endpoints = (*POSITION_COLUMNS, *ROTATION, *ROLL_PITCH_YAW, *QUATERNION, *TARGETS)
    missing = [c for c in (*KEY, *theta, *sd, *OPTIONAL, *endpoints) if c not in names]
    unknown = [name for name in names if not _known(name)]
    other_unit = {name: c for name in unknown if (c := _in_our_unit(name, missing))}
    # These columns were probably meant by misspelt names: they are not also reported as missing.
    meant = {*other_unit.values()}
    for ending, right in (("_deg", "degrees"), ("_m", "metres")):
        # Seven columns in radians are reported as one mistake.
        if matching := {name: c for name, c in other_unit.items() if c.endswith(ending)}:
            text, it = (
                ("unknown column", "it") if len(matching) == 1 else ("unknown columns", "them")
            )
            ours = ", ".join(matching.values())
            remedy = f"angles are in degrees, lengths in metres: convert {it} to {right} and name {it} {ours}"
            yield names.index(next(iter(matching))) + 1, ", ".join(matching), text, remedy
    for k, name in enumerate(names):
        if name and name in names[:k]:
            text = f"this column is given twice (columns {names.index(name) + 1} and {k + 1})"
            yield k + 1, name, text, "keep one of them"
        elif name in unknown and name not in other_unit:
            text, remedy, instead = _unknown(name, missing)
            meant.add(instead)
            yield k + 1, name or f"column {k + 1}", text, remedy
        elif (match := THETA.fullmatch(name)) and int(match[1]) > last:
            yield k + 1, name, f"the arm has {joint_count} joints", "is this the right arm?"
        elif (match := SD.fullmatch(name)) and int(match[1]) > last:
            yield k + 1, name, "there is no such joint", SPREAD_COLUMNS
    present = {*names, *meant}
    have = f" (the file has {plural(len(joints), 'joint column')}"
    have += f", the arm {plural(joint_count, 'joint')})" if joint_count is not None else ")"
    endpoint = (
        "an endpoint is x_m,y_m,z_m (and rx_deg,ry_deg,rz_deg), or three targets x1_m to z3_m"
    )
    turns = groups_in(sorted(present))
    targets = bool(present & {*TARGETS})
    if targets and (both := [c for c in names if c in POSITION_COLUMNS or group_of(c)]):
        text = "the three targets already state the tool's pose"
        yield None, both[0], text, "keep one of the two"
    for other in turns[1:]:
        text = f"states the orientation, and so does {turns[0][0]}"
        yield None, other[0], text, "keep one of the two"
    required: list[tuple[Sequence[str], str]] = [(KEY, HEADER_EXAMPLE), (theta, "")]
    required += [(sd, SPREAD_COLUMNS)] if present & {*sd} else []
    required += [(POSITION_COLUMNS, endpoint)] if turns or present & {*POSITION_COLUMNS} else []
    required += [(turn, f"write all of {','.join(turn)}, or none") for turn in turns]
    required += [(TARGETS, endpoint)] if targets else []
    for group, remedy in required:
        for name in group:
            if name not in present:
                text = f"this column is missing{have if group is theta else ''}"
                yield None, name, text, remedy or f"add {name}"


def _known(name: str) -> bool:
    fixed = name in (*KEY, *OPTIONAL, *POSITION_COLUMNS, *TARGETS) or group_of(name) is not None
    return fixed or bool(THETA.fullmatch(name) or SD.fullmatch(name))


def _in_our_unit(name: str, candidates: list[str]) -> str:
    """Return the candidate that differs from `name` only in its unit (`x_m` for `x_mm`); empty if there is none."""
    unit = UNIT.fullmatch(name)
    return next((c for c in candidates if unit and c.rpartition("_")[0] == unit[1]), "")


def _unknown(name: str, candidates: list[str]) -> tuple[str, str, str]:
    """Return text and remedy for an unknown column, and the column that was probably meant ("" if there is none)."""
    if not name:
        return "this column has no name", "name it or remove it", ""
    text = "unknown column"
    if near := difflib.get_close_matches(name, candidates, n=1, cutoff=0.75):
        return text, f"did you mean {near[0]}?", near[0]
    return text, "remove it, or move its text to the column `note`", ""


def _reader(name: str) -> Callable[[str], Any]:
    if name in ("placement", "samples"):
        return csv_table.whole_number
    texts = {
        "pose": _label,
        "utc": lambda cell: csv_table.text_of(cell.strip()),
        "note": csv_table.text_of,
    }
    return texts.get(name) or partial(_quantity, name)


def _label(cell: str) -> str:
    label = csv_table.text_of(cell.strip()).strip()
    if not label:
        raise csv_table.BadCell("the cell is empty", "give the pose a number or a name")
    return label


def _quantity(name: str, cell: str) -> float:
    value = csv_table.number(cell)
    doubt, unit = angle_doubt(value), "degrees"
    if name.endswith("_m"):
        doubt, unit = length_doubt(value), "metres"
    if doubt:
        raise csv_table.BadCell(doubt, f"this column is in {unit}")
    if name.startswith("sd") and value < 0.0:
        text = f"a standard deviation of {cell.strip()} deg is negative"
        raise csv_table.BadCell(text, "correct the number")
    return value


def _sorted_by_number(columns: Mapping[str, Sequence[Any]]) -> Mapping[str, Sequence[Any]]:
    """Return `columns` sorted by placement and pose number; unchanged unless the labels differ only in a number."""
    numbers = [NUMBERED.fullmatch(label) for label in columns["pose"]]
    if not all(numbers) or len({m[1] for m in numbers if m}) > 1:
        return columns
    keys = [(p, int(m[2])) for p, m in zip(columns["placement"], numbers, strict=True) if m]
    order = sorted(range(len(keys)), key=keys.__getitem__)
    return {name: [column[k] for k in order] for name, column in columns.items()}


def _pose_set(columns: Mapping[str, Sequence[Any]]) -> PoseSet:
    count = sum(1 for name in columns if THETA.fullmatch(name))

    def table(names: Collection[str]) -> FloatArray:
        return np.column_stack([np.array(columns[name], dtype=np.float64) for name in names])

    def angles(kind: str) -> FloatArray:
        return np.deg2rad(table([f"{kind}{j}_deg" for j in range(1, count + 1)]))

    def texts(name: str) -> tuple[str, ...] | None:
        return tuple(columns[name]) if name in columns else None

    endpoint = table(POSITION_COLUMNS) if POSITION_COLUMNS[0] in columns else None
    for group in groups_in(columns):
        if endpoint is not None:
            try:
                turns = rotation_vectors(group, table(group))
            except QuaternionError as error:
                pose = f"{columns['pose'][error.row]} (placement {columns['placement'][error.row]})"
                raise ValueError(f"pose {pose} {error}") from error
            endpoint = np.concatenate((endpoint, turns), axis=1)
    if TARGETS[0] in columns:
        endpoint = poses_of_targets(table(TARGETS), columns["pose"])
    samples = columns.get("samples")
    return PoseSet(
        placement=np.array(columns["placement"], dtype=np.int64),
        label=tuple(columns["pose"]),
        q_rad=angles("theta"),
        sd_rad=angles("sd") if "sd1_deg" in columns else None,
        samples=None if samples is None else np.array(samples, dtype=np.int64),
        endpoint=endpoint,
        utc=texts("utc"),
        notes=texts("note"),
    )


def pose_warnings(poses: PoseSet, file: str) -> Iterator[FileWarning]:
    """Yield warnings about poses that were read in degrees; `file`: name for messages."""
    if poses.endpoint is not None and poses.endpoint.shape[1] == 6:
        longest_deg = float(np.rad2deg(np.linalg.norm(poses.endpoint[:, 3:], axis=1).max()))
        if longest_deg > 180.0 + 1e-6:
            text = (
                f"rx_deg,ry_deg,rz_deg are a rotation vector, and one of {longest_deg:.0f} deg is longer than half a "
                "turn: Euler angles have other names, such as euler_zyx_1_deg or roll_deg"
            )
            yield FileWarning(code="EULER_SUSPECTED", text=text)
    largest_deg = float(np.max(np.abs(np.rad2deg(poses.q_rad))))
    if len(poses) >= FEWEST_POSES_FOR_UNIT and largest_deg < 2.0 * np.pi:
        text = f"no joint angle of {len(poses)} poses exceeds {largest_deg:.3g} deg: they may be in radians"
        yield FileWarning(code="RADIANS_SUSPECTED", text=text)
    given = poses.utc or ()
    times = [_time(utc) for utc in given] if any(given) else []
    zones = [time.tzinfo is not None for time in times if time]
    zoned = 2 * sum(zones) >= len(zones)
    for k, time in enumerate(times):
        if time is None or (time.tzinfo is not None) is not zoned:
            fault = "has no zone, others have one" if zoned else "has a zone, others have none"
            text = (
                f"{file}: utc of pose {poses.label[k]} (placement {poses.placement[k]}) is {given[k]!r}, which "
                f"{fault if time else 'is not a time'} (write 2026-01-31T12:00:00Z): the times of this file are not "
                "used, nor is the joints' direction of approach (their play)"
            )
            yield FileWarning(code="UTC_UNREADABLE", text=text)
            return


def _time(utc: str) -> datetime | None:
    try:
        return datetime.fromisoformat(utc)
    except ValueError:
        return None

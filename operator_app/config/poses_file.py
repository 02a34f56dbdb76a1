"""The poses file (CSV): ``placement,pose,theta1_deg..thetaN_deg`` and optional columns. Knows no arm.

Angles in the file are degrees and are read with ``np.deg2rad``; lengths are metres. ``sd<j>_deg``,
``samples``, ``utc``, ``note``, ``x_m,y_m,z_m`` and ``rx_deg,ry_deg,rz_deg`` (a rotation vector) may
follow. Columns may stand in any order: they are found by name.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from operator_app.config.atomic import write_atomically
from operator_app.config.degrees import degrees_for_file
from operator_app.config.poses_header import EXAMPLE, Header, header_names, read_header
from operator_app.config.poses_rows import Row, read_rows
from operator_app.config.resources import read_limited
from operator_app.config.text import decode_text, only
from solver.chain.poses import PoseSet

LIMIT_BYTES = 16 * 1024 * 1024
"""Some 100,000 poses of seven joints."""

FEW = 5
"""Fewer poses than this are too few to suspect their unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileWarning:
    """Something that may be a mistake but need not be one."""

    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedPoses:
    """Poses as read, and what looked odd about them."""

    poses: PoseSet
    warnings: tuple[FileWarning, ...]


def load_poses(path: str | Path, *, joint_count: int | None = None) -> LoadedPoses:
    """Read a poses file; raises as `parse_poses`."""
    where = Path(path).expanduser()
    return parse_poses(
        read_limited(where, str(path), limit=LIMIT_BYTES), str(path), joint_count=joint_count
    )


def parse_poses(data: bytes, file: str, *, joint_count: int | None = None) -> LoadedPoses:
    """Read poses from the bytes of a CSV file.

    Parameters
    ----------
    joint_count
        Joints of the arm the poses belong to; None takes what the file has.

    Raises
    ------
    ConfigError
        With all that is wrong (the first hundred problems of a file that is wrong all over).
    """
    lines = _lines(decode_text(data, file), file)
    header = read_header(lines[0][1], file, line=lines[0][0], joint_count=joint_count)
    rows = read_rows(lines[1:], header, file)
    poses = _pose_set(header, rows)
    return LoadedPoses(poses=poses, warnings=_warnings(poses))


def format_poses(poses: PoseSet) -> bytes:
    """Write poses as CSV: every number with the digits that read back as the same double."""
    endpoint_columns = 0 if poses.endpoint is None else int(poses.endpoint.shape[1])
    names = header_names(
        poses.joint_count,
        sd=poses.sd_rad is not None,
        samples=poses.samples is not None,
        utc=poses.utc is not None,
        note=poses.notes is not None,
        endpoint=endpoint_columns,
    )
    lines = [",".join(names)]
    q = degrees_for_file(poses.q_rad)
    sd = None if poses.sd_rad is None else degrees_for_file(poses.sd_rad)
    end = None if poses.endpoint is None else np.array(poses.endpoint)
    if end is not None and endpoint_columns == 6:
        end[:, 3:] = degrees_for_file(end[:, 3:])
    for k, (placement, label) in enumerate(poses.keys):
        cells = [str(placement), label, *(repr(float(v)) for v in q[k])]
        if sd is not None:
            cells += [repr(float(v)) for v in sd[k]]
        if poses.samples is not None:
            cells.append(str(int(poses.samples[k])))
        if poses.utc is not None:
            cells.append(poses.utc[k])
        if poses.notes is not None:
            cells.append(poses.notes[k])
        if end is not None:
            cells += [repr(float(v)) for v in end[k]]
        lines.append(",".join(_quoted(cell) for cell in cells))
    return ("\n".join(lines) + "\n").encode("utf-8")


def save_poses(path: Path, poses: PoseSet) -> None:
    """Write a poses file atomically; WriteError when the system refuses."""
    write_atomically(path, format_poses(poses))


def _quoted(cell: str) -> str:
    # Python's csv.writer leaves a lone carriage return unquoted, which ends the line for readers.
    if any(c in cell for c in ',"\r\n'):
        return '"' + cell.replace('"', '""') + '"'
    return cell


def _lines(text: str, file: str) -> list[tuple[int, list[str]]]:
    """Records with the line each starts in; blank lines are left out."""
    if not text.strip():
        raise only(file, None, None, "is empty", EXAMPLE)
    first = next(line for line in text.splitlines() if line.strip())
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in first and "," not in first:
            raise only(
                file,
                1,
                None,
                f"the columns are separated by {name}",
                "save the file with commas between columns and points as decimal marks",
            )
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    records: list[tuple[int, list[str]]] = []
    start = 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells) or len(cells) > 1:
                records.append((start, cells))
            start = reader.line_num + 1
    except csv.Error as error:
        raise only(
            file, start, None, f"is not CSV: {error}", "check the quotes in this line"
        ) from error
    if not records:
        raise only(file, None, None, "is empty", EXAMPLE)
    return records


def _pose_set(header: Header, rows: list[Row]) -> PoseSet:
    def angles(columns: tuple[str, ...]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return np.deg2rad([[row.numbers[c] for c in columns] for row in rows])

    endpoint = None
    if header.position:
        endpoint = np.array([[row.numbers[c] for c in header.position] for row in rows])
        if header.rotation:
            endpoint = np.concatenate((endpoint, angles(header.rotation)), axis=1)
    return PoseSet(
        placement=np.array([row.placement for row in rows], dtype=np.int64),
        label=tuple(row.label for row in rows),
        q_rad=angles(header.theta),
        sd_rad=angles(header.sd) if header.sd else None,
        samples=np.array([row.samples for row in rows], dtype=np.int64) if header.samples else None,
        endpoint=endpoint,
        utc=tuple(row.utc for row in rows) if header.utc else None,
        notes=tuple(row.note for row in rows) if header.note else None,
    )


def _warnings(poses: PoseSet) -> tuple[FileWarning, ...]:
    largest_deg = float(np.max(np.abs(np.rad2deg(poses.q_rad))))
    if len(poses) < FEW or largest_deg >= 2.0 * np.pi:
        return ()
    return (
        FileWarning(
            code="RADIANS_SUSPECTED",
            text=f"no joint angle of {len(poses)} poses exceeds {largest_deg:.3g} deg: "
            "radians where degrees belong?",
        ),
    )

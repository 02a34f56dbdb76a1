"""Reads measured endpoints: an instrument sends each measurement as a JSON object or as a row of CSV.

``{"pose": "12", "x_m": 1.23, "y_m": -0.4, "z_m": 0.87, "rx_deg": 1.5, "ry_deg": -2, "rz_deg": 91}``. If ``pose`` is
missing, the first measurement after the program's request is used. An instrument that does not see the target sends the
reason as ``"lost"``.

Since a rotation vector and three Euler angles look alike, the names of the columns state which of them is meant:

====================================  ==============================================================
``rx_deg, ry_deg, rz_deg``            a rotation vector: axis times angle
``roll_deg, pitch_deg, yaw_deg``      about the fixed axes x, y, z in turn: ``Rz(yaw) Ry(pitch) Rx(roll)``
``euler_zyx_1_deg, .._2_.., .._3_..``  about the moving axes z, y', x'': ``Rz(1) Ry(2) Rx(3)`` (KUKA's A, B,
                                      C); any of the twelve orders, such as ``euler_zyz_1_deg``
``qw, qx, qy, qz``                    a unit quaternion
====================================  ==============================================================
"""

import csv
import difflib
import json
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from operator_app.config.csv_table import BadCell, number
from operator_app.config.errors import only, shortened
from operator_app.config.quantities import UNIT, angle_doubt, length_doubt
from operator_app.units import LENGTH, Figure
from solver.arrays import FloatArray, frozen
from solver.chain.rotations import nearest_rotation, rotation_matrix, rotation_vector

ROTATION = ("rx_deg", "ry_deg", "rz_deg")
ROLL_PITCH_YAW = ("roll_deg", "pitch_deg", "yaw_deg")
QUATERNION = ("qw", "qx", "qy", "qz")
EULER = re.compile(r"euler_([xyz]{3})_[123]_deg")
ROTATION_EXAMPLE = (
    "rx_deg,ry_deg,rz_deg (rotation vector), roll_deg,pitch_deg,yaw_deg, "
    "euler_zyx_1_deg,euler_zyx_2_deg,euler_zyx_3_deg or qw,qx,qy,qz"
)

UNIT_WITHIN = 1e-3
"""Largest accepted deviation of a quaternion's length from 1; rounding to few digits causes such deviations."""


def group_of(name: str) -> tuple[str, ...] | None:
    """Return the columns that together state the orientation, if `name` is one of them; else None."""
    for group in (ROTATION, ROLL_PITCH_YAW, QUATERNION):
        if name in group:
            return group
    match = EULER.fullmatch(name)
    if match is None or any(a == b for a, b in zip(match[1], match[1][1:], strict=False)):
        return None
    return tuple(f"euler_{match[1]}_{k}_deg" for k in (1, 2, 3))


def groups_in(names: Collection[str]) -> tuple[tuple[str, ...], ...]:
    """Return the groups of orientation columns, such as (qw, qx, qy, qz), that have at least one member in `names`."""
    return tuple(dict.fromkeys(filter(None, map(group_of, names))))


class QuaternionError(ValueError):
    """A quaternion that is not of unit length, in row `row` (from 0)."""

    def __init__(self, lengths: FloatArray, row: int) -> None:
        self.row = row
        super().__init__(f"has a quaternion of length {lengths[row]:.4g}; the length must be 1")


def rotation_vectors(group: tuple[str, ...], values: FloatArray) -> FloatArray:
    """Convert orientations to rotation vectors (m, 3), rad; raises `QuaternionError` if a quaternion's length is not 1.

    The column names `group` state what `values` has: rotation vectors or angles (m, 3), deg, or quaternions (m, 4).
    """
    from scipy.spatial.transform import Rotation

    if group == ROTATION:
        return np.deg2rad(values)
    if group == QUATERNION:
        length = np.linalg.norm(values, axis=1)
        if np.any(np.abs(length - 1.0) > UNIT_WITHIN):
            raise QuaternionError(length, int(np.argmax(np.abs(length - 1.0))))
        return np.asarray(Rotation.from_quat(values, scalar_first=True).as_rotvec())
    # Lower case means fixed axes, upper case moving axes.
    axes = "xyz" if group == ROLL_PITCH_YAW else group[0].split("_")[1].upper()
    return np.asarray(Rotation.from_euler(axes, values, degrees=True).as_rotvec())


POSITION_COLUMNS = ("x_m", "y_m", "z_m")
NEARLY_POSITION = re.compile(r"(.*[_. ])?[xyz]([_. ]?[mcu]?m)?", re.IGNORECASE)
"""Names of columns that may be positions in another unit or spelling, such as ``x``, ``tcp_x`` or ``X_mm``."""
WITHOUT_ENDPOINTS = (
    "write lengths in metres and angles in degrees, or rename the column to leave it out"
)


def endpoint_columns(
    header: Collection[str], file: str, line: int | None = None, *, needed: bool = False
) -> tuple[str, ...]:
    """Return the names of the columns of measured endpoints: x_m, y_m, z_m, then those of the orientation, if any.

    If a position column is missing, returns an empty tuple or, if `needed`, raises ConfigError. Also raises ConfigError
    if a column occurs twice, or if the header has two orientations or an incomplete one.
    """
    if missing := [name for name in POSITION_COLUMNS if name not in header]:
        if not needed:
            return ()
        near = [name for name in header if NEARLY_POSITION.fullmatch(name)]
        remedy = "write what the instrument measured in columns x_m,y_m,z_m, in metres"
        if near:
            remedy = f"write {', '.join(near)} in metres and name them x_m, y_m, z_m"
        raise only(file, f"has no columns {', '.join(missing)}", remedy, line=line)
    groups = groups_in(header)
    turn, remedy = groups[0] if groups else (), "complete or remove its columns"
    if len(groups) > 1:
        text = f"states the orientation twice: choose one of {ROTATION_EXAMPLE}"
        raise only(file, text, remedy, line=line)
    if absent := [name for name in turn if name not in header]:
        text = f"states the orientation without {', '.join(absent)}"
        raise only(file, text, remedy, line=line)
    columns = (*POSITION_COLUMNS, *turn)
    if twice := [name for name in columns if list(header).count(name) > 1]:
        text = f"has more than one column {', '.join(twice)}"
        raise only(file, text, "keep one of each name", line=line)
    return columns


def endpoints_of(
    columns: tuple[str, ...], values: FloatArray, file: str, lines: Sequence[int]
) -> FloatArray:
    """Return measured endpoints, one per row: positions (m, 3), or positions and rotation vectors (m, 6), in m and rad.

    `columns`: names of k columns, from `endpoint_columns`. `values`: their numbers (m, k). `lines`: line number of each
    row in the file. If a value of a row is not finite, the endpoint of this row is nan. Raises ConfigError for
    implausible values, and for quaternions that are not of unit length.
    """
    turn, seen = columns[3:], np.flatnonzero(np.all(np.isfinite(values), axis=1))
    out = np.full((len(values), 6 if turn else 3), np.nan)
    if not seen.size:
        return out
    for k in range(3 if turn == QUATERNION else len(columns)):
        row = seen[np.argmax(np.abs(values[seen, k]))]
        largest = abs(float(values[row, k]))
        doubt = length_doubt(largest) if k < len(POSITION_COLUMNS) else angle_doubt(largest)
        if doubt:
            text = f"has an invalid {columns[k]}: {doubt}"
            raise only(file, text, WITHOUT_ENDPOINTS, line=lines[row])
    out[seen, :3] = values[seen, :3]
    if turn:
        try:
            out[seen, 3:] = rotation_vectors(turn, values[seen, 3:])
        except QuaternionError as error:
            line = lines[seen[error.row]]
            raise only(file, str(error), "measure that pose again", line=line) from error
    return out


def mean_endpoint(endpoints: FloatArray) -> FloatArray:
    """Return the mean (3,) or (6,) of endpoints (m, 3) or (m, 6); rotations are averaged as rotation matrices."""
    position = endpoints[:, :3].mean(axis=0)
    if endpoints.shape[1] == len(POSITION_COLUMNS):
        return np.asarray(position)
    mean = nearest_rotation(rotation_matrix(endpoints[:, 3:]).mean(axis=0))
    return np.concatenate((position, rotation_vector(mean)))


OTHER_KEYS = ("pose", "lost", "utc", "error")


class BadLine(ValueError):
    """An invalid line from an instrument; the text states the problem and, for most problems, the remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointLine:
    """One measurement of the endpoint.

    `pose`: name of the pose; empty if the instrument does not send it. `endpoint`: position (3,), m, or position and
    rotation vector (6,), m and rad; empty if the target is lost. `lost`: why it is lost; empty if it is not.
    """

    pose: str
    endpoint: FloatArray
    lost: str = ""


def read_json_line(text: str) -> EndpointLine:
    """Read a line of JSON; raises BadLine."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        shown = f"is not JSON, but {shortened(text.strip())!r}"
        raise BadLine(f"{shown}: let the instrument send one JSON object per line") from error
    if not isinstance(value, dict):
        raise BadLine(
            f"is not a JSON object, but {shortened(text.strip())!r}: let the instrument send one object per line, with "
            "x_m, y_m and z_m"
        )
    return _line_of(value)


def read_row(heading: str, text: str) -> EndpointLine:
    """Read a CSV row, given the heading; raises BadLine."""
    names, cells = _cells(heading), _cells(text)
    if len(names) != len(cells):
        raise BadLine(f"has {len(cells)} cells for {len(names)} columns")
    named = {name.strip(): cell.strip() for name, cell in zip(names, cells, strict=True)}
    return _line_of({name: cell for name, cell in named.items() if cell})


def require_heading(heading: str) -> None:
    """Raise BadLine for a heading with missing, unknown or conflicting columns: no row below it could be read."""
    _require_names([name.strip() for name in _cells(heading)])


def _cells(line: str) -> list[str]:
    try:
        return next(csv.reader([line]), [])
    except csv.Error as error:
        # For example a carriage return in the middle of the line.
        raise BadLine("is not a line of CSV: check its quotes and its line end") from error


def _line_of(fields: Mapping[str, Any]) -> EndpointLine:
    if fields.get("error"):
        raise BadLine(f"reports that the instrument failed: {fields['error']}")
    pose, lost = str(fields.get("pose", "")), str(fields.get("lost", "") or "")
    if lost:
        return EndpointLine(pose=pose, endpoint=frozen(np.zeros(0)), lost=lost)
    _require_names(fields)
    position = np.array([_number(name, fields[name]) for name in POSITION_COLUMNS])
    for group in groups_in(fields):
        values = np.array([[_number(name, fields[name]) for name in group]])
        try:
            turned = rotation_vectors(group, values)[0]
        except ValueError as error:
            raise BadLine(str(error)) from error
        if group == ROTATION and np.linalg.norm(turned) > math.pi * (1.0 + 1e-6):
            raise BadLine(
                f"has a rotation vector of {np.degrees(np.linalg.norm(turned)):.0f} deg; the limit is "
                "180 deg. Name Euler angles roll_deg,pitch_deg,yaw_deg or euler_zyx_1_deg to euler_zyx_3_deg"
            )
        position = np.concatenate((position, turned))
    return EndpointLine(pose=pose, endpoint=frozen(position))


def _require_names(names: Any) -> None:
    """Raise BadLine if a column or key is unknown or missing, or if the orientation is incomplete or stated twice."""
    known = (*POSITION_COLUMNS, *OTHER_KEYS, *ROTATION, *ROLL_PITCH_YAW, *QUATERNION)
    for name in names:
        if name in known or group_of(name) is not None:
            continue
        unit = UNIT.fullmatch(name)
        meant = [k for k in known if unit is not None and k.rpartition("_")[0] == unit[1]]
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.75)
        if meant:
            right = "degrees" if meant[0].endswith("_deg") else "metres"
            raise BadLine(f"has {name}: convert it to {right} and name it {meant[0]}")
        hint = f": did you mean {near[0]}?" if near else ""
        raise BadLine(f"has the unknown key {name}{hint}")
    if missing := [name for name in POSITION_COLUMNS if name not in names]:
        raise BadLine(f"has no {', '.join(missing)}: a measurement is x_m,y_m,z_m in metres")
    groups = groups_in(names)
    if len(groups) > 1:
        raise BadLine(f"states the orientation twice: choose one of {ROTATION_EXAMPLE}")
    if absent := [name for group in groups for name in group if name not in names]:
        raise BadLine(f"states the orientation without {', '.join(absent)}: send them as well")


def _number(name: str, value: Any) -> float:
    try:
        value_read = number(str(value))
    except BadCell as error:
        raise BadLine(f"has an invalid {name}: {error.text}") from error
    check = length_doubt if name in POSITION_COLUMNS else angle_doubt
    if name not in QUATERNION and (doubt := check(value_read)):
        raise BadLine(f"has an invalid {name}: {doubt}")
    return value_read


TARGETS = tuple(f"{axis}{k}_m" for k in (1, 2, 3) for axis in "xyz")

LEAST_HEIGHT_M = 0.01
"""If the triangle is lower than this, its targets are nearly in line: rotations about this line cannot be measured."""

MOST_OFF_M, MOST_OFF_SPREADS = 1e-3, 8.0
"""Limits of the largest distance of a pose's targets from the common triangle: in metres, and as a multiple of its
median over the poses. If both limits are exceeded, a target has moved or two targets were exchanged."""

TRIANGLE_ITERATIONS = 5
"""Iterations of aligning all triangles with their mean; the first leaves only changes of second order in the noise."""


def poses_of_targets(points_m: FloatArray, labels: Sequence[str]) -> FloatArray:
    """Return poses (m, 6), position in m and rotation vector in rad, from three target points per pose (m, 9), in m.

    An instrument that measures only points can measure a pose with three targets: columns ``x1_m,y1_m,z1_m`` to
    ``x3_m,y3_m,z3_m`` of a poses file. The positions of the targets on the tool need not be known: the mean triangle
    over all poses is used. The triangle's frame has the origin in the centroid, x towards target 1, and z normal to the
    triangle (targets 1, 2, 3 counter-clockwise). Let s be the standard deviation of a measured coordinate, and a the
    length of the triangle's sides. Then a coordinate of the origin has the standard deviation s / sqrt(3), a rotation
    about a line in the triangle's plane sqrt(2) s / a, and a rotation about the triangle's normal s / a.

    Raises `ValueError` if the targets are nearly in line, or if one pose's triangle differs from the others.
    """
    points = points_m.reshape(-1, 3, 3)
    centroid = points.mean(axis=1)
    measured = points - centroid[:, None, :]
    shape = measured[0]
    _require_a_triangle(shape)
    for _ in range(TRIANGLE_ITERATIONS):
        shape = (measured @ _turns(shape, measured)).mean(axis=0)
    turns = _turns(shape, measured)
    _require_the_same(np.linalg.norm(measured @ turns - shape, axis=-1).max(axis=1), labels)
    return np.concatenate((centroid, rotation_vector(turns @ _frame(shape))), axis=1)


def _turns(shape: FloatArray, measured: FloatArray) -> FloatArray:
    """Return rotations (m, 3, 3) that align the points in the rows of `shape` (3, 3) with `measured` (m, 3, 3)."""
    return nearest_rotation(np.swapaxes(measured, -1, -2) @ shape)


def _frame(shape: FloatArray) -> FloatArray:
    """Return the axes x, y, z of a triangle's frame as columns (3, 3). Rows of `shape`: points minus centroid."""
    x = shape[0] / np.linalg.norm(shape[0])
    z = np.cross(shape[0], shape[1])
    z = z / np.linalg.norm(z)
    return np.column_stack((x, np.cross(z, x), z))


def _require_a_triangle(points: FloatArray) -> None:
    longest = float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).max())
    area = float(np.linalg.norm(np.cross(points[1] - points[0], points[2] - points[0]))) / 2.0
    if 2.0 * area < LEAST_HEIGHT_M * longest or longest == 0.0:
        shown = Figure(2.0 * area / longest if longest else 0.0, LENGTH, places=1).with_unit
        least = Figure(LEAST_HEIGHT_M, LENGTH, places=0).with_unit
        raise ValueError(
            f"the three targets are nearly in line: their triangle is {shown} high, and at least {least} "
            "is needed for the orientation: move one of them away from the line through the others"
        )


def _require_the_same(off_m: FloatArray, labels: Sequence[str]) -> None:
    k = int(np.argmax(off_m))
    if off_m[k] > max(MOST_OFF_M, MOST_OFF_SPREADS * float(np.median(off_m))):
        shown = Figure(float(off_m[k]), LENGTH, places=1).with_unit
        raise ValueError(
            f"pose {labels[k]}: its targets differ by {shown} from the triangle of the other poses: one moved, or two "
            "were exchanged"
        )

"""Measured poses: made from arrays, CSV files or data frames, and written to CSV files."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from operator_app.config.csv_table import write_records
from operator_app.config.poses_file import FileWarning, parse_poses, pose_warnings, save_poses
from operator_app.config.poses_file import load_poses as load_poses_file
from operator_app.config.quantities import length_doubt
from solver.arrays import FloatArray, IntArray
from solver.chain.poses import PoseSet

from .calls import WholeNumbers, numbers, required_shape, shown, whole

FRAME = "data frame"

WHOLE_COLUMNS = ("placement", "pose", "samples")

HALF_TURN_RAD = 1.01 * math.pi
"""Largest length of a rotation vector, with a margin for noise."""


@dataclass(frozen=True, slots=True)
class Poses:
    """Joint readings of m poses; made by `poses_of` or `load_poses`.

    Attributes
    ----------
    source
        Text that states the origin of the poses, such as the path of a file.

    Examples
    --------
    >>> import numpy as np
    >>> import sarcal
    >>> poses = sarcal.poses_of(q_deg=np.zeros((12, 7)))
    >>> poses
    <sarcal.Poses: 12 poses of 7 joints>
    >>> len(poses), poses.q_rad.shape
    (12, (12, 7))
    """

    source: str
    _set: PoseSet = field(repr=False)
    _warnings: tuple[FileWarning, ...] = field(default=(), repr=False)

    @property
    def q_rad(self) -> FloatArray:
        """Sensor readings, shape (m, n), rad, read-only."""
        return self._set.q_rad

    @property
    def q_deg(self) -> FloatArray:
        """Sensor readings in degrees, shape (m, n)."""
        return np.rad2deg(self._set.q_rad)

    @property
    def placement(self) -> IntArray:
        """Number (from 1) of the fixture placement of each pose, shape (m,)."""
        return self._set.placement

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each pose, unique within its placement."""
        return self._set.label

    def to_csv(self, path: str | PathLike[str]) -> Path:
        """Write a poses file, angles in degrees, and return its path; rounding is the only loss.

        Raises WriteError if the file cannot be written.
        """
        target = Path(path)
        save_poses(target, self._set)
        return target

    def __len__(self) -> int:
        return len(self._set)

    def __repr__(self) -> str:
        placements = len(self._set.placements)
        where = f" in {placements} placements" if placements > 1 else ""
        return f"<sarcal.Poses: {len(self)} poses of {self._set.joint_count} joints{where}>"


def poses_of(
    *,
    q_rad: ArrayLike | None = None,
    q_deg: ArrayLike | None = None,
    placement: int | WholeNumbers | None = None,
    names: Sequence[str] | None = None,
    samples: int | WholeNumbers | None = None,
    sd_rad: ArrayLike | None = None,
    endpoint_m: ArrayLike | None = None,
) -> Poses:
    """Make `Poses` from arrays.

    Parameters
    ----------
    q_rad, q_deg
        Sensor readings (m, n), in one of the two units, without offsets added. They must not jump by a turn at +-180
        deg. If `q_deg` looks like radians, the `Result` of a calibration from these poses has a warning.
    placement
        Number (from 1) of the fixture placement of each pose (m,), or one number for all; None: a single placement.
    names
        Name of each pose; None: 1 to m.
    samples, sd_rad
        Number of samples averaged in each pose (m,), and their standard deviation (m, n), rad. One number applies to
        all poses; standard deviations may also be one per joint (n,). `samples` None: one sample per pose.
    endpoint_m
        Endpoint measured by an instrument, for a ``measured`` fixture: (m, 3), or (m, 6) with a rotation vector of at
        most half a turn, rad. With any other fixture, `calibrate` ignores the endpoint, and its `Result` has a warning.

    Raises
    ------
    TypeError, ValueError
        The poses are invalid; the text gives the reason.

    Examples
    --------
    >>> import sarcal
    >>> sarcal.poses_of(q_rad=[[0.1, 0.2], [0.3, 0.4]], names=["left", "right"]).names
    ('left', 'right')
    >>> sarcal.poses_of(q_rad=[0.1, 0.2])
    Traceback (most recent call last):
    ...
    ValueError: q_rad has shape (2,): it must have one row per pose and one column per joint
    """
    if (q_rad is None) == (q_deg is None):
        raise ValueError("give the readings in one unit only: q_rad=... or q_deg=...")
    name = "q_deg" if q_rad is None else "q_rad"
    angles = numbers("q_rad", q_rad) if q_deg is None else np.deg2rad(numbers("q_deg", q_deg))
    if angles.ndim != 2 or not angles.size:
        problem = "it contains no reading; give a row for each pose"
        if angles.ndim != 2:
            problem = "it must have one row per pose and one column per joint"
        raise ValueError(f"{name} has shape {angles.shape}: {problem}")
    if isinstance(names, str):
        raise TypeError(f"names={names!r}: give a list of one name per pose")
    m = len(angles)
    if names is not None and len(names) != m:
        raise ValueError(f"names has length {len(names)}, not {m}: give one name per pose")
    pose_set = PoseSet(
        placement=_one_a_pose("placement", 1 if placement is None else placement, m),
        label=tuple(str(k) for k in range(1, m + 1)) if names is None else tuple(names),
        q_rad=angles,
        sd_rad=None if sd_rad is None else _spread_rad(sd_rad, angles.shape),
        samples=None if samples is None else _one_a_pose("samples", samples, m),
        endpoint=None if endpoint_m is None else _endpoint_m(endpoint_m, m),
    )
    warnings = () if q_deg is None else tuple(pose_warnings(pose_set, name))
    return Poses("an array", pose_set, warnings)


def _one_a_pose(name: str, value: Any, poses: int) -> IntArray:
    """Return one whole number (1 or more) per pose, (m,); a `value` that is a single number applies to all poses."""
    values = [value] * poses if np.ndim(value) == 0 else value
    numbers_read = [whole(name, number, least=1) for number in values]
    if len(numbers_read) != poses:
        raise ValueError(
            f"{name} has length {len(numbers_read)}, not {poses}: give one number per pose"
        )
    try:
        return np.array(numbers_read, dtype=np.int64)
    except OverflowError:
        raise ValueError(f"{name} contains {max(numbers_read)}: give numbers below 2**63") from None


def _spread_rad(value: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return standard deviations of the readings (m, n), rad; one number, or one per joint, applies to all poses."""
    spread = numbers("sd_rad", value)
    if spread.shape not in (shape, shape[1:], ()):
        raise ValueError(
            f"sd_rad has shape {spread.shape}: give {shape} like the readings, {shape[1:]} for one per joint, or one "
            "number"
        )
    return np.broadcast_to(spread, shape)


def _endpoint_m(value: Any, poses: int) -> FloatArray:
    """Return the measured endpoints: points (m, 3), m, or points and rotation vectors (m, 6), m and rad."""
    endpoint = numbers("endpoint_m", value)
    if endpoint.shape not in ((poses, 3), (poses, 6)):
        raise ValueError(
            f"endpoint_m has shape {endpoint.shape}: give {(poses, 3)} (x, y, z per pose) or {(poses, 6)} (with "
            "a rotation vector)"
        )
    if doubt := length_doubt(float(np.abs(endpoint[:, :3]).max())):
        raise ValueError(f"endpoint_m: {doubt}")
    longest_rad = float(np.linalg.norm(endpoint[:, 3:], axis=1).max())
    if longest_rad > HALF_TURN_RAD:
        raise ValueError(
            f"endpoint_m has a rotation vector of {longest_rad:.4g} rad; the limit is half a turn (3.1416 rad): "
            "convert degrees with np.deg2rad, and Euler angles to rotation vectors"
        )
    return endpoint


def load_poses(
    source: str | PathLike[str] | Poses | Any, *, joint_count: int | None = None
) -> Poses:
    """Read poses from a CSV file, or from a data frame with the same columns.

    Parameters
    ----------
    source
        Path of a file, or a data frame (with ``to_csv``, as in pandas, or ``write_csv``, as in polars) that has the
        columns ``theta1_deg`` to ``thetaN_deg``, and optionally ``placement``, ``pose``, ``sd1_deg``.., ``samples``,
        ``x_m``, ``y_m``, ``z_m``. `Poses`, also those of a `Simulation`, are returned unchanged.
    joint_count
        Required number of joints; None: any.

    Raises
    ------
    ConfigError
        The file is invalid; the text lists all problems with line, column and remedy.
    ValueError
        The `Poses` do not have `joint_count` joints.
    TypeError
        `source` is no path, data frame or `Poses`. For an array, use `poses_of`, which states the unit.
    """
    held = getattr(source, "poses", None)
    if isinstance(held, Poses):
        source = held
    if joint_count is not None:
        joint_count = whole("joint_count", joint_count, least=1)
    if isinstance(source, Poses):
        if joint_count is not None and source._set.joint_count != joint_count:
            shape = source.q_rad.shape
            raise ValueError(f"the poses have shape {shape}: {required_shape(shape, joint_count)}")
        return source
    if isinstance(source, str | PathLike):
        read = load_poses_file(fspath(source), joint_count=joint_count)
        return Poses(fspath(source), read.poses, read.warnings)
    if getattr(source, "columns", None) is None:
        raise TypeError(
            "a bare array does not state its unit: use sarcal.poses_of(q_rad=...) or "
            "sarcal.poses_of(q_deg=...)"
            if isinstance(source, Sequence | np.ndarray)
            else f"poses={shown(source)}: give a path, a data frame, or what sarcal.poses_of returned"
        )
    read = parse_poses(_csv_of(source), FRAME, joint_count=joint_count)
    return Poses(FRAME, read.poses, read.warnings)


def _csv_of(frame: Any) -> bytes:
    cells = {
        str(c): [_cell(v, whole_number=c in WHOLE_COLUMNS) for v in frame[c]] for c in frame.columns
    }
    count = len(next(iter(cells.values()), []))
    head = {"placement": ["1"] * count, "pose": [str(k) for k in range(1, count + 1)]}
    all_columns = head | cells
    return write_records([list(all_columns), *zip(*all_columns.values(), strict=True)])


def _cell(value: Any, *, whole_number: bool) -> str:
    """Return a value as text, with enough digits that reading it back gives the same double.

    With `whole_number`, 32.0 is written as 32: pandas turns whole numbers into floats, e.g. in a column with gaps.
    """
    plain = value.item() if hasattr(value, "item") else value
    if whole_number and isinstance(plain, float) and plain.is_integer():
        return str(int(plain))
    return repr(plain) if isinstance(plain, float) else str(plain)

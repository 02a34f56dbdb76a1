"""The result of a calibration as a document: what the controller is given. Knows no file format.

A document lives at the edge: its numbers are in the units of its file (degrees, metres, millimetres,
milliradians), so that writing and reading it changes no bit. `ParametersDocument.table` gives SI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from operator_app.config.degrees import degrees_for_file
from solver.arrays import FloatArray, frozen
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.sensors import NoSensor


@dataclass(frozen=True, slots=True, kw_only=True)
class JointParameters:
    """One joint.

    Attributes
    ----------
    theta_off_deg
        Joint-angle offset: theta' = theta + theta_off.
    sigma_deg
        Its standard deviation; None where it was not calibrated.
    home_offset_counts
        The offset in counts of the joint's sensor, for 607Ch; None for a joint without a sensor.
    """

    joint: int
    theta_off_deg: float
    sigma_deg: float | None
    home_offset_counts: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DhRow:
    """One D-H row, 0 (the fixture) to n."""

    row: int
    theta_off_deg: float
    s_m: float
    a_m: float
    alpha_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedEntry:
    """An entry that was calibrated, with its standard deviation in deg (angles) or m (lengths)."""

    entry: str
    sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoFigures:
    """A figure in both readings of eqs. 14 and 15."""

    rms: float
    as_printed: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """How good the calibration is."""

    poses: int
    rank: int
    scaled_condition_number: float
    sigma_pos_mm: TwoFigures
    sigma_ori_mrad: TwoFigures
    chi2_per_dof: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentWarning:
    """A warning, as the operator saw it."""

    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ParametersDocument:
    """Parameters of one arm from one calibration.

    Attributes
    ----------
    arm_model, arm_serial
        Which arm.
    joints, dh, calibrated
        Offsets, the whole D-H table (rows 0..n), and which of its entries were calibrated.
    fixture, fixture_kind
        The fixture that closed the loop.
    quality, warnings, estimator
        How it went.
    pose_set_sha256
        `solver.chain.poses.PoseSet.sha256` of the poses.
    software_version, utc
        What made the document, and when (aware, UTC).
    """

    arm_model: str
    arm_serial: str
    joints: tuple[JointParameters, ...]
    dh: tuple[DhRow, ...]
    calibrated: tuple[CalibratedEntry, ...]
    fixture: str
    fixture_kind: str
    quality: Quality
    warnings: tuple[DocumentWarning, ...]
    estimator: str
    pose_set_sha256: str
    software_version: str
    utc: datetime

    def __post_init__(self) -> None:
        if len(self.dh) != len(self.joints) + 1:
            raise ValueError("an arm of n joints has D-H rows 0 to n")
        if self.utc.utcoffset() != UTC.utcoffset(None):
            raise ValueError("the time of a document is UTC")

    @property
    def table(self) -> DhTable:
        """The whole table, rows 0..n, in SI units."""
        return DhTable(
            theta_off_rad=np.deg2rad([row.theta_off_deg for row in self.dh]),
            s_m=frozen([row.s_m for row in self.dh]),
            a_m=frozen([row.a_m for row in self.dh]),
            alpha_rad=np.deg2rad([row.alpha_deg for row in self.dh]),
        )

    @property
    def theta_off_rad(self) -> FloatArray:
        """Offsets of joints 1..n, shape (n,), rad."""
        return np.deg2rad([joint.theta_off_deg for joint in self.joints])


def rows_from_table(table: DhTable) -> tuple[DhRow, ...]:
    """Rows 0..n of a table in SI units, in the units of the document."""
    theta_off_deg = degrees_for_file(table.theta_off_rad)
    alpha_deg = degrees_for_file(table.alpha_rad)
    return tuple(
        DhRow(
            row=k,
            theta_off_deg=float(theta_off_deg[k]),
            s_m=float(table.s_m[k]),
            a_m=float(table.a_m[k]),
            alpha_deg=float(alpha_deg[k]),
        )
        for k in range(table.links)
    )


def joints_from_table(
    arm: ArmModel, table: DhTable, calibrated: tuple[CalibratedEntry, ...]
) -> tuple[JointParameters, ...]:
    """Per-joint part of a document: offsets of rows 1..n of `table`, their sigmas and counts."""
    sigma = {entry.entry: entry.sigma for entry in calibrated}
    rows = rows_from_table(table)[1:]
    return tuple(
        JointParameters(
            joint=row.row,
            theta_off_deg=row.theta_off_deg,
            sigma_deg=sigma.get(f"theta_off_{row.row}"),
            home_offset_counts=home_offset_counts(arm, row.row, math.radians(row.theta_off_deg)),
        )
        for row in rows
    )


def home_offset_counts(arm: ArmModel, joint: int, theta_off_rad: float) -> int | None:
    """Offset in whole counts of the joint's sensor (607Ch); None for a joint without a sensor."""
    sensor = arm.joints[joint - 1].sensor
    return None if isinstance(sensor, NoSensor) else round(theta_off_rad / sensor.resolution_rad)

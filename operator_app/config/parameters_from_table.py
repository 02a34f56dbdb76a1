"""Rows and joints of a parameters document from a D-H table in SI. Knows no file and no estimator."""

from __future__ import annotations

import math

from operator_app.config.degrees import degrees_for_file
from operator_app.config.parameter_records import CalibratedEntry, DhRow, JointParameters
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.sensors import NoSensor


def rows_from_table(table: DhTable) -> tuple[DhRow, ...]:
    """Rows 0..n of a table in SI units, in the units of the document."""
    theta_off_deg = degrees_for_file(table.theta_off_rad)
    alpha_deg, beta_deg = map(degrees_for_file, (table.alpha_rad, table.beta_rad))
    return tuple(
        DhRow(
            row=k,
            theta_off_deg=float(theta_off_deg[k]),
            s_m=float(table.s_m[k]),
            a_m=float(table.a_m[k]),
            alpha_deg=float(alpha_deg[k]),
            beta_deg=float(beta_deg[k]),
        )
        for k in range(table.links)
    )


def joints_from_table(
    arm: ArmModel, table: DhTable, calibrated: tuple[CalibratedEntry, ...]
) -> tuple[JointParameters, ...]:
    """Per-joint part of a document: offsets of rows 1..n of `table`, their sigmas and counts."""
    sigma = {entry.entry: entry.sigma for entry in calibrated}
    return tuple(
        JointParameters(
            joint=row.row,
            theta_off_deg=row.theta_off_deg,
            sigma_deg=sigma.get(f"theta_off_{row.row}"),
            home_offset_counts=home_offset_counts(arm, row.row, math.radians(row.theta_off_deg)),
        )
        for row in rows_from_table(table)[1:]
    )


def home_offset_counts(arm: ArmModel, joint: int, theta_off_rad: float) -> int | None:
    """Offset in whole counts of the joint's sensor (607Ch); None for a joint without a sensor."""
    sensor = arm.joints[joint - 1].sensor
    return None if isinstance(sensor, NoSensor) else round(theta_off_rad / sensor.resolution_rad)

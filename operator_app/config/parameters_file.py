"""The parameters file (``sarcal/parameters/3``): reads and writes it, and builds it from a table.

Versions 1 and 2 are also read.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from operator_app.config.atomic import dump_strict, write_atomically
from operator_app.config.errors import ConfigError, only
from operator_app.config.parameter_records import CalibratedEntry, DhRow, JointParameters
from operator_app.config.parameters import ParametersDocument
from operator_app.config.quantities import degrees_for_file
from operator_app.config.resources import YAML_LIMIT_BYTES, expanded, read_limited
from operator_app.config.schema import adapter, is_unlike_any_key, read_model, schema_name
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.sensors import NoSensor

COMMENT = "Written by sarcal. A controller checks it against this schema; edit it only on purpose."
WITHOUT_BETA = "sarcal/parameters/2"
RESULT = "the result"
REMEDY = "this calibration cannot be exported: take more poses that differ more from each other"
OF_A_NEWER = "a newer sarcal may have written it: use that version, or remove this key"
"""Remedy for an unknown key, which is not a misspelling, since programs write this file."""


def parse_parameters(data: bytes, file: str = "parameters") -> ParametersDocument:
    """Read a parameters document from its bytes; raises ConfigError with all its problems."""
    try:
        return read_model(ParametersDocument, data, kind="parameters", file=file)
    except ConfigError as error:
        raise ConfigError(
            replace(p, remedy=OF_A_NEWER) if is_unlike_any_key(p) else p for p in error.problems
        ) from error


def load_parameters(path: str | Path) -> ParametersDocument:
    """Read a parameters file; raises the same errors as `parse_parameters`."""
    where = expanded(path)
    return parse_parameters(read_limited(where, str(path), limit=YAML_LIMIT_BYTES), str(path))


def format_parameters(document: ParametersDocument) -> bytes:
    """Format a document so that `parse_parameters` returns the same document, bit for bit.

    It is checked, as it may go to a controller: raises ConfigError if it is invalid, e.g. after a diverged fit.
    """
    # An entry has one sigma of the two (deg or m); the other is left out.
    body = adapter(ParametersDocument).dump_python(document, exclude_defaults=True)
    # Without a beta, programs of version 2 can read it.
    name = schema_name("parameters") if document.table.beta_rad.any() else WITHOUT_BETA
    try:
        data = dump_strict({"schema": name, **body}, comment=COMMENT)
        parse_parameters(data, RESULT)
    except ValueError as error:
        raise only(RESULT, str(error), REMEDY) from error
    except ConfigError as error:
        raise ConfigError(replace(p, line=None, remedy=REMEDY) for p in error.problems) from error
    return data


def save_parameters(path: Path, document: ParametersDocument) -> None:
    """Write a parameters file atomically; raises WriteError, and the errors of `format_parameters`."""
    write_atomically(path, format_parameters(document))


def rows_from_table(table: DhTable) -> tuple[DhRow, ...]:
    """Convert rows 0..n of a table in SI units to the units of the document."""
    angles = (table.theta_off_rad, table.alpha_rad, table.beta_rad)
    columns = (*map(degrees_for_file, angles), table.s_m, table.a_m)
    return tuple(
        DhRow(row=k, theta_off_deg=theta_off, alpha_deg=alpha, beta_deg=beta, s_m=s, a_m=a)
        for k, (theta_off, alpha, beta, s, a) in enumerate(np.column_stack(columns).tolist())
    )


def joints_from_table(
    arm: ArmModel, table: DhTable, calibrated: tuple[CalibratedEntry, ...]
) -> tuple[JointParameters, ...]:
    """Return the joints of a document: offsets of rows 1..n of `table`, their sigmas and counts."""
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
    """Return an offset in whole counts of the joint's sensor (607Ch); None for a joint without a sensor."""
    sensor = arm.joints[joint - 1].sensor
    return None if isinstance(sensor, NoSensor) else round(theta_off_rad / sensor.resolution_rad)

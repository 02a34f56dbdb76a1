"""A calibration in the formats of other tools: JSON, CSV, URDF, MATLAB, as bytes.

Each format states what every parameter describes: the arm, or the fixture on the table ("ground") or on the tool
("hand"). Only the parameters of the arm stay valid in another mounting. A URDF contains only the arm.
"""

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from operator_app.calibration.calibrated_arm import (
    CalibratedArm,
    calibrated_arm,
    last_placement,
    side_of,
)
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.config import urdf_editing
from operator_app.config.csv_table import write_records
from operator_app.config.urdf_rows import link_transform
from operator_app.report.facts import facts_of
from operator_app.report.parameter_tables import values_of
from operator_app.report.uncertainty_tables import dh_rows_data
from operator_app.units import quantity_of
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet

EXPORT_FILES = {
    "json": "result.json",
    "csv": "parameters.csv",
    "urdf": "arm.urdf",
    "mat": "result.mat",
}

CSV_HEADER = ("parameter", "side", "unit", "nominal", "value", "sigma")


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A calibration to export. `forced`: reason for exporting it although it was not accepted; empty if accepted."""

    solution: Solution
    checks: Checks | None
    arm: ArmModel
    serial_number: str
    poses: PoseSet
    forced: str = ""

    @property
    def by_itself(self) -> CalibratedArm:
        """The calibrated arm as an open chain, without the fixture."""
        return calibrated_arm(self.solution, self.arm)


def in_format(calibration: Calibration, kind: str) -> bytes:
    """Return the calibration in one of the formats in `EXPORT_FILES`, as bytes."""
    return {"json": _json, "csv": _csv, "urdf": _urdf, "mat": _mat}[kind](calibration)


def _json(calibration: Calibration) -> bytes:
    document = {
        "schema": "sarcal/result/1",
        "arm": {"model": calibration.arm.name, "serial": calibration.serial_number},
        **facts_of(calibration.solution, checks=calibration.checks).json,
        "dh_arm": _rows(calibration),
        "forced": calibration.forced,
        "pose_set_sha256": calibration.poses.sha256(),
        "software_version": version("sarcal"),
    }
    return (json.dumps(document, indent=2, allow_nan=False) + "\n").encode()


def _rows(calibration: Calibration) -> list[dict[str, Any]]:
    arm = calibration.by_itself
    rows: list[dict[str, Any]] = []
    for k, row in enumerate(dh_rows_data(arm.table().stacked()), 1):
        if k not in calibration.arm.hayati_rows:
            del row["beta_deg"]
        calibrated = [n for n in arm.identified if n.endswith(f"_{k}")]
        rows.append({"row": k, **row, "calibrated": calibrated})
    return rows


def _csv(calibration: Calibration) -> bytes:
    solution = calibration.solution
    reason = () if solution.accepted else (" ".join(calibration.forced.split()),)
    rows = [CSV_HEADER if solution.accepted else (*CSV_HEADER, "forced")]
    for p, *values in values_of(solution.identified):
        quantity, side = quantity_of(p), side_of(solution.model, p.name)
        numbers = (repr(quantity.per_si * float(v)) for v in (p.nominal, *values))
        rows.append((p.name, side, quantity.unit, *numbers, *reason))
    return write_records(rows, texts=("forced",))


def into_description(calibration: Calibration, data: bytes, file: str) -> bytes:
    """Return the user's own URDF, xacro or UR kinematics file with the calibration in its joint origins.

    Raises ConfigError if the file cannot be read, or describes another arm.
    """
    chain = urdf_editing.chain_of(data, file, calibration.arm)
    missing, figures = urdf_editing.entries_without_origin(chain), []
    own = [name for name in calibration.by_itself.identified if name not in missing]
    for p, *values in values_of(calibration.solution.identified):
        if p.name in own:
            value, sigma = (quantity_of(p).per_si * v for v in values)
            figures.append(f"{p.name}: {value:.6f}, sigma {sigma:.6f} {quantity_of(p).unit}")
    comments = ["Only joint origins are changed.", *_provenance(calibration, own), *figures]
    return urdf_editing.with_calibration(data, file, chain, calibration.by_itself.table(), comments)


def _urdf(calibration: Calibration) -> bytes:
    arm, n = calibration.by_itself, calibration.arm.joint_count
    comments = [
        *_provenance(calibration, arm.identified),
        f"The link 'flange' is frame {n} of the D-H table, 'tip' the fixture's point. No masses, no shapes.",
    ]
    T_tip = link_transform(arm.table("tip").stacked()[:, -1].tolist())
    T_tip[:3, 3] += T_tip[:3, :3] @ arm.table_tip_m
    return urdf_editing.format_urdf(calibration.arm, arm.table(), T_tip=T_tip, comment=comments)


def _provenance(calibration: Calibration, written: Sequence[str]) -> list[str]:
    calibrated = calibration.by_itself.identified
    left_out = [name for name in calibrated if name not in written]
    offsets = calibration.solution.unsensed_offsets or {}
    unsensed = [f"theta_off_{j}" for j in offsets if f"theta_off_{j}" in calibrated]
    model = last_placement(calibration.solution)[0].with_all_joints_sensed()
    sides = {*model.ground_side, *model.hand_side}
    mounting = [p.name for p in model.parameters if p.name in sides]
    comments = [
        f"{calibration.arm.name}, serial {calibration.serial_number}, calibrated by sarcal {version('sarcal')}",
        f"from {calibration.solution.poses} poses (SHA-256 {calibration.poses.sha256()}).",
        "Joint values are sensor readings: the joint-angle offsets are in the origins.",
        f"Calibrated: {', '.join(written) or 'no entry of the arm itself'}.",
        "As in the arm file, because they depend on the mounting:",
        f"{', '.join(mounting)}.",
    ]
    if left_out:
        comments += [f"Not in this file, which ends at its last joint: {', '.join(left_out)}."]
    if unsensed:
        comments.append(
            f"{', '.join(unsensed)}: the mean of the angle that closes the loop minus the reading, which was not used."
        )
    if not calibration.solution.accepted:
        reasons = "; ".join(calibration.solution.reasons)
        comments += [f"NOT ACCEPTED: {reasons}.", f"Used: {calibration.forced}"]
    return comments


def _mat(calibration: Calibration) -> bytes:
    from scipy.io import savemat

    estimate, arm, buffer = calibration.solution.identified, calibration.by_itself, io.BytesIO()
    names = [p.name for p in estimate.parameters]
    sides = [side_of(calibration.solution.model, name) for name in names]
    savemat(
        buffer,  # type: ignore[arg-type] # the stubs accept only paths
        {
            "arm_model": calibration.arm.name,
            "arm_serial": calibration.serial_number,
            "verdict": calibration.solution.verdict.value,
            "forced": calibration.forced,
            "names": np.array(names, dtype=object),
            "side": np.array(sides, dtype=object),
            "is_angle": np.array([p.is_angle for p in estimate.parameters]),
            "value_rad_or_m": estimate.x,
            "nominal_rad_or_m": np.array([p.nominal for p in estimate.parameters]),
            "sigma_rad_or_m": estimate.standard_deviation,
            "covariance_rad_or_m": estimate.covariance,
            # One row per link: theta_off_rad, s_m, a_m, alpha_rad, beta_rad.
            "dh_arm_rad_m": arm.table().stacked().T,
            "dh_hand_rad_m": arm.table("tip").stacked().T,
            "tip_m": arm.tip_m,
            "q_rad": calibration.poses.q_rad,
            "placement": calibration.poses.placement,
            "T_base_tip": np.moveaxis(arm.T_base(calibration.poses.q_rad), 0, -1),
        },
        oned_as="column",
    )
    return buffer.getvalue()

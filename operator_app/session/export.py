"""From a judged calibration to the parameter document, the session's files and the controller.

Everything written here can be made again from the journal. Prints nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

from hardware.arm import Arm, UploadReceipt
from operator_app.calibration.solution import Solution
from operator_app.config.parameters import (
    CalibratedEntry,
    DocumentWarning,
    ParametersDocument,
    Quality,
    TwoFigures,
    WhichArm,
    WhichFixture,
)
from operator_app.config.parameters_from_table import joints_from_table, rows_from_table
from operator_app.config.procedure import Procedure
from operator_app.errors import SessionError
from operator_app.session.state import SessionState
from solver.estimators.goodness import TwoReadings

PARAMETERS_NAME = "parameters.yaml"
POSES_NAME = "poses.csv"


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """Where everything is. `receipt` is None when nothing was uploaded."""

    folder: Path
    parameters: Path
    poses: Path
    receipt: UploadReceipt | None


def document_of(
    solution: Solution,
    state: SessionState,
    procedure: Procedure,
    *,
    utc: datetime,
    forced: str = "",
) -> ParametersDocument:
    """Return the document that describes a session's calibration completely.

    `forced` says why one that was not accepted is used all the same: the first of its warnings.
    """
    arm, fixture = procedure.arm, procedure.fixture
    estimate, model = solution.estimate, solution.model
    table = model.dh_table(estimate.x)
    if table is None:
        raise SessionError(
            f"a {fixture.kind} calibration has no D-H table of the closed loop",
            "export is for hinge and rigid fixtures",
        )
    calibrated = tuple(
        CalibratedEntry.of(p.name, math.degrees(s) if p.is_angle else float(s))
        for p, s in zip(estimate.parameters, estimate.standard_deviation, strict=True)
    )
    return ParametersDocument(
        arm=WhichArm(model=arm.name, serial=state.serial_number),
        joints=joints_from_table(arm, table, calibrated),
        dh=rows_from_table(table),
        calibrated=calibrated,
        fixture=WhichFixture(name=fixture.name, kind=fixture.kind),
        quality=Quality(
            poses=solution.poses,
            rank=solution.seen.rank,
            scaled_condition_number=solution.seen.scaled_condition_number,
            sigma_pos_mm=_figures(estimate.sigmas.position_m),
            sigma_ori_mrad=_figures(estimate.sigmas.orientation_rad),
            chi2_per_dof=estimate.chi2_per_dof,
        ),
        warnings=(
            *_in_spite_of(solution, forced),
            *(DocumentWarning(code=n.code, text=n.text) for n in solution.warnings),
        ),
        estimator=estimate.estimator,
        pose_set_sha256=state.pose_set().sha256(),
        software_version=version("sarcal"),
        utc=utc,
    )


def upload(arm: Arm, document: bytes, expected_counts: tuple[int | None, ...]) -> UploadReceipt:
    """Upload a document and insist that the controller holds it byte for byte.

    Raises
    ------
    SessionError
        What was read back is not what was sent.
    """
    receipt = arm.upload_parameters(document)
    if arm.active_parameters() != document:
        raise SessionError(
            "the controller's active parameters are not the ones that were uploaded",
            "upload again; if it happens twice, do not move the arm and look at the supervisor",
        )
    for joint, (wanted, found) in enumerate(
        zip(expected_counts, receipt.home_offset_counts, strict=True), 1
    ):
        if wanted is not None and wanted != found:
            raise SessionError(
                f"joint {joint} holds home offset {found} counts where {wanted} were uploaded",
                "upload again; if it happens twice, do not move the arm and look at that drive",
            )
    return receipt


def _in_spite_of(solution: Solution, reason: str) -> tuple[DocumentWarning, ...]:
    if not reason:
        return ()
    # One line, as every text of the document.
    said = " ".join(reason.split())
    text = f"not accepted ({'; '.join(solution.reasons)}); used all the same: {said}"
    return (DocumentWarning(code="FORCED", text=text),)


def _figures(reading: TwoReadings) -> TwoFigures:
    """m to mm, rad to mrad."""
    return TwoFigures(rms=1e3 * reading.rms, as_printed=1e3 * reading.as_printed)

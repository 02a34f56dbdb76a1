"""Makes the parameters document, the content of parameters.yaml, from a calibration and its session."""

import math
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime

import numpy as np

from operator_app.calibration.calibrated_arm import last_placement, side_of
from operator_app.calibration.result import Solution
from operator_app.calibration.rvdt import ReadingTable, reading_tables
from operator_app.config import parameter_records as records
from operator_app.config.parameters_file import (
    ParametersDocument,
    joints_from_table,
    rows_from_table,
)
from operator_app.config.procedure import Procedure
from operator_app.errors import GuardError, SessionError
from operator_app.session.store.journal import utc_now
from operator_app.session.store.state import SessionState
from operator_app.session.store.stored_calibration import software_version
from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable
from solver.loops.arm_loop import ArmLoop
from solver.loops.closure import ClosureModel, ResidualSigma
from solver.loops.placements import Placements


def export_reason(solution: Solution, reason: str, *, stated_by: str) -> str:
    """Return the reason for exporting a calibration that was not accepted; "" if it was accepted.

    `stated_by`: how the operator states a reason, such as ``--force REASON``. Raises GuardError if the calibration was
    not accepted and there is no reason.
    """
    if solution.accepted:
        return ""
    if not reason.strip():
        raise GuardError(
            f"the calibration was not accepted: {'; '.join(solution.reasons)}",
            f"remove the causes, or state why these parameters are to be used ({stated_by})",
        )
    return reason


def parameters_document(
    solution: Solution, state: SessionState, procedure: Procedure, *, forced: str = ""
) -> ParametersDocument:
    """Return the parameters document of a session's calibration, with the time of the calibration.

    If the calibration was not accepted, the first warning in the document states that, and the reason `forced`.
    """
    arm, fixture = procedure.arm, procedure.fixture
    estimate, turned = solution.estimate, solution.estimate.sigmas.orientation_rad
    model, column = last_placement(solution)
    columns = list(column.values())
    table = _table_of(model, estimate.x[columns], fixture.kind)
    theta_off_rad = np.array(table.theta_off_rad)
    for joint, offset in (solution.unsensed_offsets or {}).items():
        theta_off_rad[joint] = offset.value_rad
    table = replace(table, theta_off_rad=theta_off_rad)
    own = model.own if isinstance(model, ArmLoop) else ()
    calibrated = tuple(
        records.CalibratedEntry.of(
            p.name, math.degrees(s) if p.is_angle else float(s), side_of(model, p.name)
        )
        for p, s in zip(model.parameters, estimate.standard_deviation[columns], strict=True)
        if p.name not in own
    )
    listed = {part.entry: column[part.entry] for part in calibrated}
    rows = list(listed.values())
    return ParametersDocument(
        arm=records.WhichArm(model=arm.name, serial=state.serial_number),
        joints=joints_from_table(arm, table, calibrated),
        dh=rows_from_table(table),
        calibrated=calibrated,
        fixture=records.WhichFixture(name=fixture.name, kind=fixture.kind),
        quality=records.Quality(
            poses=solution.poses,
            # Parameters of other placements are not in this document.
            rank=solution.identifiability.rank - (len(estimate.parameters) - len(model.parameters)),
            scaled_condition_number=solution.identifiability.scaled_condition_number,
            sigma_pos_mm=_figures(estimate.sigmas.position_m),
            sigma_ori_mrad=None if turned is None else _figures(turned),
            chi2_per_dof=estimate.chi2_per_dof,
        ),
        warnings=(
            *_forced_warning(solution, forced),
            *_several(solution.model),
            *(records.DocumentWarning(code=n.code, text=n.sentence) for n in solution.warnings),
        ),
        estimator=estimate.estimator,
        pose_set_sha256=state.pose_set().sha256(),
        correlations=records.correlations_of(
            tuple(listed), estimate.covariance[np.ix_(rows, rows)]
        ),
        budget=_budget(solution, listed),
        rvdt=tuple(map(rvdt_remedy, reading_tables(solution))),
        forced=" ".join(forced.split()) or None,
        software_version=software_version(),
        # A calibration that the journal does not contain was made just now.
        utc=datetime.fromisoformat(state.solved_utc) if state.solved_utc else utc_now(),
    )


def _budget(solution: Solution, listed: Mapping[str, int]) -> Mapping[str, Mapping[str, float]]:
    if solution.components is None:
        return {}
    estimate = solution.estimate
    rows = {
        n: k for n, k in listed.items() if estimate.parameters[k].name not in solution.tolerated
    }
    where = list(rows.values())
    parts = {source: part[where] for source, part in solution.components.budget.items()}
    return records.budget_of(tuple(rows), np.diagonal(estimate.covariance)[where], parts)


def _several(model: ClosureModel) -> tuple[records.DocumentWarning, ...]:
    if not isinstance(model, Placements):
        return ()
    text = (
        f"calibrated in {len(model.numbers)} placements of the fixture; the fixture entries are those of "
        f"placement {model.placement.max()}, the last"
    )
    return (records.DocumentWarning(code="PLACEMENTS", text=text),)


def _table_of(model: ClosureModel, x: FloatArray, kind: str) -> DhTable:
    """Return the D-H table of links 0..n with the entries `x` (P,); row 0 is zero if the fixture is not a D-H link."""
    table = model.dh_table(x)
    if table is not None:
        return table
    if not isinstance(model, ArmLoop):
        raise SessionError(
            f"{kind} fixtures in several placements have no common D-H table",
            "export the calibration of one placement",
        )
    rows = model.tables(x)
    return DhTable.from_stacked(np.column_stack((np.zeros(len(rows)), rows)))


def rvdt_remedy(table: ReadingTable) -> records.RvdtRemedy:
    """Return the RVDT corrections of a joint in the format of a parameters file (deg)."""
    columns = (table.reading_rad, table.add_rad, table.sigma_rad)
    return records.RvdtRemedy(
        joint=table.joint,
        theta_off_deg=math.degrees(table.theta_off_rad),
        gain=table.gain,
        table=tuple(
            records.Correction(reading_deg=reading, add_deg=add, sigma_deg=sigma)
            for reading, add, sigma in np.rad2deg(columns).T.tolist()
        ),
    )


def _forced_warning(solution: Solution, reason: str) -> tuple[records.DocumentWarning, ...]:
    if solution.accepted:
        return ()
    code, text = records.NOT_ACCEPTED, f"not accepted ({'; '.join(solution.reasons)})"
    if reason := " ".join(reason.split()):
        code, text = records.FORCED, f"{text}; exported because: {reason}"
    return (records.DocumentWarning(code=code, text=text),)


def _figures(reading: ResidualSigma) -> records.TwoFigures:
    """Return a residual's rms, and its value by the paper's formula as printed, in mm or mrad instead of m or rad."""
    return records.TwoFigures(rms=1e3 * reading.rms, as_printed=1e3 * reading.as_printed)

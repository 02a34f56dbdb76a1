"""Reads the parameters document of a file or session, and the calibration history of an arm."""

import math
from datetime import datetime, timedelta
from pathlib import Path

from operator_app.calibration import history
from operator_app.config.parameters_file import ParametersDocument, load_parameters
from operator_app.config.resources import exists, expanded
from operator_app.errors import SessionError
from operator_app.session.store import folders
from operator_app.session.store.journal import read_journal
from operator_app.session.store.parameters_document import parameters_document
from operator_app.session.store.state import SessionState
from operator_app.session.store.stored_calibration import StoredCalibration, journal_calibration
from operator_app.session.workflow.importing import UNKNOWN_SERIAL_NUMBER
from operator_app.session.workflow.opening import Choices, resume


def parameters_at(reference: str, root: Path) -> ParametersDocument:
    """Return the parameters document of a file or of a session (folder, name in `root`, or ``latest``).

    Raises `ConfigError` or `SessionError` if there is no such file or session, or no calibration in it.
    """
    where = expanded(reference)
    if exists(where) and where.is_file():
        return load_parameters(reference)
    folder = folders.find_session(root, reference)
    state = folders.read_session(folder).state
    calibration = None if state is None else journal_calibration(state)
    if state is not None and isinstance(calibration, StoredCalibration):
        return _document(folder, state, calibration)
    file = folder / folders.PARAMETERS_NAME
    if not file.is_file():
        raise SessionError(
            f"{folder}: this session has no {folders.PARAMETERS_NAME}",
            f"write it with: sarcal export {folder}",
        )
    return load_parameters(file)


def arm_history(
    serial: str, root: Path, *, kept_mounted: bool = False, interval: timedelta | None = None
) -> history.ArmHistory:
    """Return the history of an arm, from the journals of the sessions below `root`.

    `kept_mounted`: whether the fixture stayed mounted between sessions; a session with several placements counts as
    remounted in any case. `interval`: time until the next calibration; None: the usual time between past calibrations.
    Raises `SessionError` if this arm has no accepted calibration.
    """
    calibrations: list[history.PastCalibration] = []
    checks: list[history.PastVerification] = []
    left_out: list[tuple[str, str]] = []
    serials: set[str] = set()
    mounting = 0
    for entry in folders.list_sessions(root):
        state, name = entry.state, entry.folder.name
        if state is None:
            left_out.append((name, f"its journal cannot be read: {entry.problem}"))
            continue
        serials.add(state.serial_number)
        if state.serial_number != serial:
            continue
        calibration = journal_calibration(state)
        if isinstance(calibration, str):
            if state.used_poses:
                left_out.append((name, calibration))
            continue
        if not calibration.solution.accepted:
            left_out.append((name, "not accepted"))
            continue
        several = len({pose.placement for pose in state.used_poses}) > 1
        mounting += several or not kept_mounted
        calibrations.append(
            history.PastCalibration(
                session=name,
                document=_document(entry.folder, state, calibration),
                within=calibration.solution.within,
                mounting=mounting,
            )
        )
        checks += [
            history.PastVerification(
                session=name,
                utc=datetime.fromisoformat(event.utc),
                poses=int(event.data.get("poses", 0)),
                holds=bool(event.data.get("holds")),
                position_m=float(event.data.get("position_m", math.nan)),
                why=str(event.data.get("why", "")),
            )
            for event in read_journal(entry.folder).events
            if event.name == "verified"
        ]
    if not calibrations:
        known = ", ".join(sorted(serials - {"", UNKNOWN_SERIAL_NUMBER})) or "none"
        raise SessionError(
            f"{root}: no accepted calibration of an arm with serial number {serial}",
            f"serial numbers there: {known}; another folder: --sessions",
        )
    return history.history_of(calibrations, checks, left_out=left_out, interval=interval)


def _document(
    folder: Path, state: SessionState, calibration: StoredCalibration
) -> ParametersDocument:
    procedure = resume(str(folder), Choices(), root=folder.parent).effective_procedure
    return parameters_document(calibration.solution, state, procedure)

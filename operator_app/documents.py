"""The parameters document that a reference means: a file, or the calibration in a session's journal."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from operator_app.carried_procedure import carried_procedure
from operator_app.config.parameters_file import load_parameters
from operator_app.config.resources import expanded
from operator_app.errors import SessionError
from operator_app.session.store.folders import PARAMETERS_NAME, find_session, read_session
from operator_app.session.store.parameters import document_of
from operator_app.session.store.stored_calibration import StoredCalibration, recorded
from operator_app.session.workflow.opening import Choices, resume

if TYPE_CHECKING:
    from operator_app.config.parameters import ParametersDocument


def parameters_at(reference: str, root: Path) -> ParametersDocument:
    """Read a parameters file, or the calibration in the journal of a session.

    Parameters
    ----------
    reference
        A file; a session's folder, its name below `root`, or ``latest``.

    Raises
    ------
    ConfigError, SessionError
        There is none; says what to do.
    """
    where = expanded(reference)
    if where.is_file():
        return load_parameters(reference)
    try:
        folder = find_session(root, reference)
    except SessionError:
        # A folder with the file alone, as somebody sent it.
        folder = where
        if not (where / PARAMETERS_NAME).is_file():
            raise
    found = _journalled(folder)
    if found is not None:
        return found
    file = folder / PARAMETERS_NAME
    if not file.is_file():
        raise SessionError(
            f"{folder}: this session has no {PARAMETERS_NAME}",
            f"write it with: sarcal export {folder}",
        )
    return load_parameters(file)


def _journalled(folder: Path) -> ParametersDocument | None:
    """Return what an export of a session's calibration would write; None where its journal has none."""
    state = read_session(folder).state
    found = None if state is None else recorded(state)
    if state is None or not isinstance(found, StoredCalibration):
        return None
    procedure = carried_procedure(resume(str(folder), Choices(), root=folder.parent))
    solved = datetime.fromisoformat(state.solved_utc)
    return document_of(found.solution, state, procedure, utc=solved)

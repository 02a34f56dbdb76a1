"""A session's calibration as `run` and `report` give it: the facts, and where everything of it is.

Computes nothing, prints nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from operator_app.report.calibration_data import unidentifiable_data
from operator_app.report.facts import Facts, estimate_json
from operator_app.session.folder import POSES_NAME
from operator_app.session.journal_lines import JOURNAL_NAME
from operator_app.session.state import SessionState
from solver.errors import UnidentifiableError
from solver.estimators.estimate import Estimate


def session_json(
    facts: Facts, paper: Estimate | None, folder: Path, state: SessionState
) -> dict[str, Any]:
    """Return the object of `sarcal run --json`, but for how its capture went."""
    exported = state.exported
    uploaded: Mapping[str, Any] = exported.get("uploaded") or {}
    return {
        **facts.json,
        "paper": None if paper is None else estimate_json(paper),
        "session": {
            "folder": str(folder),
            "journal": str(folder / JOURNAL_NAME),
            "serial_number": state.serial_number,
            "parameters": str(folder / exported["file"]) if exported else None,
            "poses": _poses_file(folder),
            "uploaded": bool(uploaded),
            "sha256": uploaded.get("sha256"),
        },
    }


def unidentifiable_json(
    error: UnidentifiableError, *, parameters: int, poses: int, folder: Path
) -> dict[str, Any]:
    """Return the same of a session whose poses leave parameters undetermined."""
    found = unidentifiable_data(error, parameters=parameters, poses=poses)
    return {
        **found,
        "paper": None,
        "session": {"folder": str(folder), "poses": _poses_file(folder)},
    }


def _poses_file(folder: Path) -> str | None:
    """Beside the journal from the first calibration on."""
    return str(folder / POSES_NAME) if (folder / POSES_NAME).exists() else None


def session_text(folder: Path, state: SessionState, *, accepted: bool) -> str:
    """Say where the session, its files and its upload are."""
    lines, exported = [f"Session     {folder}"], state.exported
    if poses := _poses_file(folder):
        lines.append(f"Poses       {poses}")
    if not exported:
        why = "" if accepted else ": the calibration was not accepted"
        return "\n".join([*lines, f"Parameters  not written{why}"])
    lines.append(f"Parameters  {folder / exported['file']}")
    uploaded = exported["uploaded"]
    if uploaded is None:
        return "\n".join([*lines, "Controller  nothing uploaded"])
    slot, length = uploaded["slot"], uploaded["length"]
    lines.append(f"Controller  slot {slot} active, {length} bytes read back")
    return "\n".join([*lines, f"            SHA-256 {uploaded['sha256']}"])

"""A session's calibration as `run` and `report` give it: the facts, and where everything of it is.

Computes nothing, prints nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from operator_app.report.calibration_data import unidentifiable_data
from operator_app.report.facts import Facts, estimate_json
from operator_app.session.export import POSES_NAME
from operator_app.session.journal_lines import JOURNAL_NAME
from operator_app.session.state import SessionState
from solver.errors import UnidentifiableDirection
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
            "poses": str(folder / POSES_NAME) if exported else None,
            "uploaded": bool(uploaded),
            "sha256": uploaded.get("sha256"),
        },
    }


def unidentifiable_json(
    directions: tuple[UnidentifiableDirection, ...], *, parameters: int, poses: int, folder: Path
) -> dict[str, Any]:
    """Return the same of a session whose poses leave parameters undetermined."""
    found = unidentifiable_data(directions, parameters=parameters, poses=poses)
    return {**found, "paper": None, "session": {"folder": str(folder)}}


def session_text(folder: Path, state: SessionState, *, accepted: bool) -> str:
    """Say where the session, its files and its upload are."""
    lines = [f"Session     {folder}"]
    exported = state.exported
    if not exported:
        why = "" if accepted else ": the calibration was not accepted"
        return "\n".join([*lines, f"Parameters  not written{why}"])
    lines += [f"Poses       {folder / POSES_NAME}", f"Parameters  {folder / exported['file']}"]
    uploaded = exported["uploaded"]
    if uploaded is None:
        return "\n".join([*lines, "Controller  nothing uploaded"])
    slot, length = uploaded["slot"], uploaded["length"]
    lines.append(f"Controller  slot {slot} active, {length} bytes read back")
    return "\n".join([*lines, f"            SHA-256 {uploaded['sha256']}"])

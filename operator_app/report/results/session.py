"""A session's calibration as `run` and `report` give it: the facts, and where everything of it is.

Computes nothing but whether a poses file is of these poses; prints nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from operator_app.config.errors import ConfigError
from operator_app.config.poses_file import format_poses, load_poses
from operator_app.report.facts import Facts, estimate_json
from operator_app.report.json_schema import unidentifiable_data
from operator_app.session.store.folders import POSES_NAME
from operator_app.session.store.journal_format import JOURNAL_NAME

if TYPE_CHECKING:
    from operator_app.session.store.state import SessionState
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
            "poses": _poses_file(folder, state),
            "uploaded": bool(uploaded),
            "sha256": uploaded.get("sha256"),
        },
    }


def unidentifiable_json(
    error: UnidentifiableError, *, parameters: int, folder: Path, state: SessionState
) -> dict[str, Any]:
    """Return the same of a session whose poses leave parameters undetermined."""
    poses = len(state.used_poses)
    found = unidentifiable_data(error, parameters=parameters, poses=poses)
    return {
        **found,
        "paper": None,
        "session": {"folder": str(folder), "poses": _poses_file(folder, state)},
    }


def _poses_file(folder: Path, state: SessionState) -> str | None:
    """Beside the journal from the first calibration on; named while it holds the poses that count now."""
    path = folder / POSES_NAME
    if not path.exists() or not state.used_poses:
        return None
    poses = state.pose_set()
    try:
        # To the byte; or, where only a note was added since, in what a calibration uses.
        same = path.read_bytes() == format_poses(poses) or (
            load_poses(path).poses.sha256() == poses.sha256()
        )
    except (ConfigError, OSError):
        return None
    return str(path) if same else None


def session_text(folder: Path, state: SessionState, *, accepted: bool) -> str:
    """Say where the session, its files and its upload are."""
    lines, exported = [f"Session     {folder}"], state.exported
    if poses := _poses_file(folder, state):
        lines.append(f"Poses       {poses}")
    elif (folder / POSES_NAME).exists():
        lines.append(
            f"Poses       in the journal; {POSES_NAME} was written before they were changed"
        )
    if not exported:
        why = "" if accepted else ": the calibration was not accepted"
        return "\n".join([*lines, f"Parameters  not written{why}"])
    lines.append(f"Parameters  {folder / exported['file']}")
    uploaded = exported["uploaded"]
    if exported.get("unknown"):
        return "\n".join([*lines, f"Controller  not known: {exported['unknown']}"])
    if uploaded is None:
        return "\n".join([*lines, "Controller  nothing uploaded"])
    slot, length = uploaded["slot"], uploaded["length"]
    lines.append(f"Controller  slot {slot} active, {length} bytes read back")
    return "\n".join([*lines, f"            SHA-256 {uploaded['sha256']}"])

"""Output of `run`, `report` and `session`: calibration, planned capture, poses, repaired journal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from operator_app import units
from operator_app.config.errors import ConfigError
from operator_app.report.table import Cell, FactTable, figures, words
from operator_app.report.text import (
    facts_text,
    paragraph,
    table_lines,
    table_text,
    unidentifiable_text,
)
from operator_app.safe_output import as_json
from operator_app.session.store.folders import POSES_NAME
from operator_app.session.store.journal_format import JOURNAL_NAME
from operator_app.units import Figure, Kind, joints_named, names, others_free, plural, quantity_of
from solver.errors import UnidentifiableError

if TYPE_CHECKING:
    from operator_app.config.procedure import Procedure
    from operator_app.report.facts import Facts
    from operator_app.session.store.journal_repair import RepairedLine, RepairResult
    from operator_app.session.store.state import CapturedPose, SessionState
    from solver.chain.parameters import Parameter
    from solver.design.actions import Finished


def result_text(
    result: Facts | UnidentifiableError,
    procedure: Procedure,
    folder: Path,
    state: SessionState,
    *,
    in_json: bool,
    more: Mapping[str, Any] | None = None,
    capture: str = "",
) -> str:
    """Return what a command prints about a calibration, or about poses that leave parameters undetermined.

    `more`: further keys of the JSON object. `capture`: text about a planned capture.
    """
    if in_json:
        data = _result_data(result, procedure, state)
        return as_json(data | {"session": _session_data(folder, state)} | dict(more or {}))
    if isinstance(result, UnidentifiableError):
        return unidentifiable_text(result)
    session = session_text(folder, state, accepted=result.solution.accepted)
    return "\n\n".join(filter(None, (facts_text(result), capture, session)))


def _result_data(
    result: Facts | UnidentifiableError, procedure: Procedure, state: SessionState
) -> dict[str, Any]:
    from operator_app.calibration.experiment import Experiment
    from operator_app.report.calibration_json import unidentifiable_data
    from operator_app.report.facts import estimate_json

    if not isinstance(result, UnidentifiableError):
        paper = result.solution.paper
        return {**result.json, "paper": None if paper is None else estimate_json(paper)}
    experiment = Experiment(
        arm=procedure.arm,
        fixture=procedure.fixture.fixture,
        poses=state.pose_set(),
        unsensed=procedure.unsensed_joints,
    )
    data = unidentifiable_data(result, experiment, estimator=procedure.estimator)
    return {**data, "paper": None}


def _session_data(folder: Path, state: SessionState) -> dict[str, Any]:
    exported = state.exported
    uploaded: Mapping[str, Any] = exported.get("uploaded") or {}
    return {
        "folder": str(folder),
        "journal": str(folder / JOURNAL_NAME),
        "serial_number": state.serial_number,
        "parameters": str(folder / exported["file"]) if exported else None,
        "poses": _poses_file(folder, state),
        "uploaded": bool(uploaded),
        "sha256": uploaded.get("sha256"),
    }


def _poses_file(folder: Path, state: SessionState) -> str | None:
    from operator_app.config.poses_file import format_poses, load_poses

    path = folder / POSES_NAME
    if not path.exists() or not state.used_poses:
        return None
    poses = state.pose_set()
    try:
        # The same bytes or, if only a note was added since, the same data for a calibration.
        same = path.read_bytes() == format_poses(poses) or (
            load_poses(path).poses.sha256() == poses.sha256()
        )
    except (ConfigError, OSError):
        return None
    return str(path) if same else None


def session_text(folder: Path, state: SessionState, *, accepted: bool) -> str:
    """Return text with the paths of the session and its files, and the result of the upload."""
    lines, exported = [f"Session     {folder}"], state.exported
    if poses := _poses_file(folder, state):
        lines.append(f"Poses       {poses}")
    elif (folder / POSES_NAME).exists():
        text = f"in the journal; {POSES_NAME} was written before they were changed"
        lines.append(f"Poses       {text}")
    if not exported:
        hint = f"sarcal export {folder}" if accepted else "the calibration was not accepted"
        return "\n".join([*lines, f"Parameters  not written: {hint}"])
    lines.append(f"Parameters  {folder / exported['file']}")
    if exported.get("unknown"):
        lines.append(f"Controller  not known: {exported['unknown']}")
    elif (uploaded := exported["uploaded"]) is None:
        lines.append("Controller  nothing uploaded")
    else:
        slot, length = uploaded["slot"], uploaded["length"]
        lines.append(f"Controller  slot {slot} active, {length} bytes read back")
        lines.append(f"            SHA-256 {uploaded['sha256']}")
    return "\n".join(lines)


MOST_POSES_LISTED = 60
"""Maximum number of rows of the table of poses; poses.csv has all poses."""


def session_table_text(folder: Path, state: SessionState, *, procedure: str, torn: str) -> str:
    """Return a table about the session, and a table of its poses, as text.

    `torn`: text about a part dropped from the end of the journal; empty if there is none.
    """
    tables = [_about(folder, state, procedure, torn), *([_poses(state)] if state.poses else [])]
    return "\n\n".join(map(table_text, tables))


def _about(folder: Path, state: SessionState, procedure: str, torn: str) -> FactTable:
    position = state.position_joints
    driven = f"{joints_named(position)}{others_free(len(position), len(state.modes))}"
    poses = f"{plural(len(state.used_poses), 'pose')} that count"
    if excluded := [p.number for p in state.poses if p.excluded]:
        poses += f", pose{'s' if len(excluded) > 1 else ''} {names(excluded)} excluded"
    rows = [
        ("folder", str(folder)),
        ("procedure", procedure),
        ("begun (UTC)", state.opened_utc[:19].replace("T", " ")),
        ("arm, serial number", state.serial_number or "none connected"),
        ("poses read from", state.imported),
        ("in position mode", driven if position else ""),
        ("poses", poses),
        ("solved", _solved(state)),
        ("exported", _exported(state)),
        ("journal's end", torn),
    ]
    return FactTable(
        ident="session",
        title=f"Session {folder.resolve().name}",
        columns=words("what", "is"),
        rows=tuple(row for row in rows if row[1]),
    )


def solved_json(state: SessionState) -> dict[str, Any]:
    """Return the journal's summary of the last calibration as JSON, parameters in deg or m; empty if there is none."""
    from operator_app.report.results.history import quantity

    solved = dict(state.solved)
    if "parameters" in solved:
        known = solved["parameters"].items()
        solved["parameters"] = {name: Figure(si, quantity(name)).in_json for name, si in known}
    return solved


def _solved(state: SessionState) -> str:
    solved = state.solved
    if not solved:
        return "not yet"
    verdict = "accepted" if solved["accepted"] else "not accepted"
    by = f" by {solved['estimator']}" if solved.get("estimator") else ""
    condition = solved.get("scaled_condition_number")
    number = (
        "" if condition is None else f", scaled condition number {units.CONDITION(condition).shown}"
    )
    return f"{verdict}{by}{number}"


def _exported(state: SessionState) -> str:
    exported = state.exported
    if not exported:
        # `sarcal export` writes files from any session; its journal records only an upload.
        return "nothing recorded in its journal"
    uploaded, where = exported["uploaded"], "nothing uploaded"
    if exported.get("unknown"):
        where = "the content of the controller is unknown"
    elif uploaded:
        where = f"slot {uploaded['slot']} of the controller"
    forced = f"; for a reason: {exported['forced']}" if exported.get("forced") else ""
    return f"{exported['file']}, {where}{forced}"


def _poses(state: SessionState) -> FactTable:
    several = len({p.placement for p in state.poses}) > 1
    rows: list[tuple[Cell, ...]] = []
    for pose in state.poses[:MOST_POSES_LISTED]:
        remark = f"excluded: {pose.excluded}" if pose.excluded else pose.note
        remark = remark if len(remark) <= 24 else f"{remark[:23]}…"
        placement = [str(pose.placement)] if several else []
        readings = (Figure(v, units.ANGLE, places=2) for v in pose.mean_rad.tolist())
        sd = Figure(float(np.max(pose.sd_rad)) or None, units.NOISE_ANGLE, places=1)
        rows.append((str(pose.number), *placement, *readings, sd, remark))
    joints = len(state.poses[0].mean_rad)
    left_out = len(state.poses) - len(rows)
    return FactTable(
        ident="poses",
        title="Poses: mean readings [deg], largest sd [mdeg]",
        columns=(
            *words("pose"),
            *(words("in") if several else ()),
            *figures(*(f"j{j}" for j in range(1, joints + 1))),
            *figures("sd"),
            *words("note"),
        ),
        rows=tuple(rows),
        note=f"{left_out} more are in its poses.csv." if left_out else "",
    )


INTACT = "kept"


def fate(line: RepairedLine) -> str:
    """Return what the repair did with a line: ``kept``, ``restored`` or ``lost``."""
    if line.event is None:
        return "lost"
    return "restored" if line.words else INTACT


def repair_json(repair: RepairResult) -> dict[str, Any]:
    """Return the repair as JSON data."""
    return {
        "folder": str(repair.folder),
        "repaired": repair.aside is not None,
        "original": None if repair.aside is None else str(repair.aside),
        "lines": [
            {
                "line": line.number,
                "fate": fate(line),
                "event": None if line.event is None else line.event.name,
                "why": line.words,
            }
            for line in repair.lines
        ],
        "poses": len(repair.state.used_poses),
    }


def repair_text(repair: RepairResult) -> str:
    """Return the repair as paragraphs."""
    folder, state = repair.folder, repair.state
    if repair.aside is None:
        torn = " Its last line is incomplete: a resumed session omits it." if repair.torn else ""
        return paragraph(
            f"{folder}: the journal is complete, {len(repair.lines)} lines; nothing was changed.{torn}"
        )
    lines = [paragraph(f"{folder}: repaired. The damaged journal is untouched in {repair.aside}.")]
    for what, of_kind in groupby(repair.lines, key=fate):
        if what != INTACT:
            for line in of_kind:
                name = "" if line.event is None else f" ({line.event.name.replace('_', ' ')})"
                text = f"  line {line.number}: {what}{name}: {line.words}"
                lines.append(paragraph(text, indent=4))
            continue
        first, *others = (line.number for line in of_kind)
        text = f"  line {first}: kept, verified by its checksum"
        if others:
            text = f"  lines {first} to {others[-1]}: kept, verified by their checksum"
        lines.append(text)
    if repair.torn:
        lines.append("  the last line is incomplete and was left out")
    lines.append(f"{len(state.used_poses)} poses count.")
    if repair.lost:
        text = (
            "Earlier calibrations of this session are no longer used, because a pose or its exclusion may be lost: "
            "check the poses before you calibrate again."
        )
        lines.append(paragraph(text))
    if state.sources:
        lines.append(f"Go on with: sarcal run --resume {folder}")
    else:
        text = "Line 1, which opened the session, is lost, so that it cannot be resumed: start a new one."
        lines.append(paragraph(text))
    return "\n".join(lines)


def capture_json(
    end: Finished | None,
    advice: str,
    parameters: Iterable[Parameter],
    poses: Sequence[CapturedPose],
) -> dict[str, Any] | None:
    """Return the JSON object of a planned capture: how it ended, weak parameters, advice; None if `end` is None."""
    if end is None:
        return None
    kinds, weak = {p.name: Kind(quantity_of(p)) for p in parameters}, []
    for w in end.weak:
        sigma, requested = (kinds[w.name](v).in_json for v in (w.sigma, w.requested))
        weak.append({"name": w.name, "sigma": sigma, "requested": requested})
    return {
        "complete": end.complete,
        "text": end.text,
        "explored": sum(not p.planned for p in poses),
        "planned": sum(p.planned for p in poses),
        "weak": weak,
        "advice": advice or None,
    }


def capture_text(end: Finished | None, advice: str, parameters: Iterable[Parameter]) -> str:
    """Return text on how a planned capture ended, which parameters are less precise than requested, and advice.

    Empty if `end` is None.
    """
    if end is None:
        return ""
    kinds = {p.name: Kind(quantity_of(p), places=4) for p in parameters}
    rows: list[tuple[Cell, ...]] = []
    for w in end.weak:
        kind = kinds[w.name]
        rows.append((w.name, kind.quantity.unit, kind(w.sigma), kind(w.requested)))
    columns = (*words("short of the request", "unit"), *figures("sigma", "requested"))
    weak = FactTable(ident="weak", title="", columns=columns, rows=tuple(rows))
    lines = [paragraph(f"Plan        {end.text}.", indent=12), *table_lines(weak)]
    if advice:
        lines.append(paragraph(f"Advice      {advice}.", indent=12))
    return "\n".join(lines)

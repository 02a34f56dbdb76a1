"""A session on a terminal: what it is about and how far it came, its poses. Solves nothing, prints nothing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from operator_app.planning.mode_rule import and_the_others
from operator_app.report.table import Cell, Column, FactTable, figures, words
from operator_app.report.text import table_text
from operator_app.units.figure import ANGLE, CONDITION, NOISE_ANGLE, Figure
from operator_app.units.numbers import joints_named, names, plural

if TYPE_CHECKING:
    from operator_app.session.store.state import SessionState

MOST_POSES = 60
"""In the table; `poses.csv` has them all."""


def session_table_text(folder: Path, state: SessionState, *, procedure: str, torn: str) -> str:
    """Return two tables: the session, and its poses.

    Parameters
    ----------
    procedure
        What it follows, in words.
    torn
        What was dropped from the journal's end; empty: nothing.
    """
    about = FactTable(
        ident="session",
        title=f"Session {folder.resolve().name}",
        columns=words("what", "is"),
        rows=tuple(_about(folder, state, procedure, torn)),
    )
    return "\n\n".join(map(table_text, (about, *([_poses(state)] if state.poses else []))))


def _about(folder: Path, state: SessionState, procedure: str, torn: str) -> list[tuple[Cell, ...]]:
    position = [j for j, mode in enumerate(state.modes, 1) if mode == "position"]
    excluded = [p.number for p in state.poses if p.excluded]
    poses = plural(len(state.used_poses), "pose") + " that count"
    if excluded:
        poses += f", {names(excluded)} excluded"
    rows = [
        ("folder", str(folder)),
        ("procedure", procedure),
        ("begun (UTC)", state.opened_utc[:19].replace("T", " ")),
        ("arm, serial number", state.serial_number or "none connected"),
        ("poses read from", state.imported),
        (
            "in position mode",
            f"{joints_named(position)}{and_the_others(len(position), len(state.modes))}"
            if position
            else "",
        ),
        ("poses", poses),
        ("solved", _solved(state)),
        ("exported", _exported(state)),
        ("journal's end", torn),
    ]
    return [row for row in rows if row[1]]


def _solved(state: SessionState) -> str:
    solved = state.solved
    if not solved:
        return "not yet"
    said = "accepted" if solved["accepted"] else "not accepted"
    by = f" by {solved['estimator']}" if solved.get("estimator") else ""
    condition = solved.get("scaled_condition_number")
    number = "" if condition is None else f", scaled condition number {CONDITION(condition).shown}"
    return f"{said}{by}{number}"


def _exported(state: SessionState) -> str:
    exported = state.exported
    if not exported:
        # `sarcal export` writes files from any session, and only an upload is of its journal.
        return "nothing that its journal knows of"
    uploaded = exported["uploaded"]
    where = f", slot {uploaded['slot']} of the controller" if uploaded else ", nothing uploaded"
    if exported.get("unknown"):
        where = ", what the controller has of it is not known"
    forced = f"; for a reason: {exported['forced']}" if exported.get("forced") else ""
    return f"{exported['file']}{where}{forced}"


def _poses(state: SessionState) -> FactTable:
    shown = state.poses[:MOST_POSES]
    several = len({p.placement for p in state.poses}) > 1
    rows: list[tuple[Cell, ...]] = []
    for pose in shown:
        remark = f"excluded: {pose.excluded}" if pose.excluded else pose.note
        largest = float(np.max(pose.sd_rad))
        rows.append(
            (
                str(pose.number),
                *([str(pose.placement)] if several else []),
                *(Figure(v, ANGLE, places=2) for v in pose.mean_rad.tolist()),
                Figure(largest if largest > 0.0 else None, NOISE_ANGLE, places=1),
                remark if len(remark) <= 24 else f"{remark[:23]}…",
            )
        )
    joints = len(shown[0].mean_rad)
    left_out = len(state.poses) - len(shown)
    return FactTable(
        ident="poses",
        title="Poses: mean readings [deg], largest sd [mdeg]",
        columns=(
            *words("pose"),
            *(words("in") if several else ()),
            *figures(*(f"j{j}" for j in range(1, joints + 1))),
            *figures("sd"),
            *(Column("note", words=True),),
        ),
        rows=tuple(rows),
        note=f"{left_out} more are in its poses.csv." if left_out else "",
    )

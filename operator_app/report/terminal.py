"""Facts as lines of spans for a terminal's panels, built once per calibration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from operator_app.report.facts import Facts, facts_of
from operator_app.report.spans import Line, line
from operator_app.report.subject import Subject
from operator_app.report.table import FactTable, Headline
from operator_app.report.text import placed
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.units import Figure


def facts_on(s: SessionSnapshot) -> Facts | None:
    """Return the facts of a snapshot's calibration; None where its poses have none."""
    return None if no_facts(s) else _facts(_Same(s))


def subject_on(s: SessionSnapshot) -> Subject | None:
    """Return the report subject of a snapshot's calibration; None where its poses have none."""
    return None if no_facts(s) else _subject(_Same(s))


def no_facts(s: SessionSnapshot) -> str:
    """Say why there is no calibration to show; empty where there is one."""
    if s.solution is None:
        return "no calibration of these poses yet"
    counting = sum(not pose.excluded for pose in s.state.poses)
    if counting != s.solution.poses + len(s.solution.dropped_flipped):
        return "the calibration is of other poses than those that count now: calibrate again"
    return ""


class _Same:
    """Cache key of a snapshot: the calibration that it holds; snapshots come 20 times a second."""

    def __init__(self, s: SessionSnapshot) -> None:
        self.s = s
        self._parts = s.solution, s.cross_checks, s.state.poses, s.state.modes

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and all(
            one is another for one, another in zip(self._parts, other._parts, strict=True)
        )

    def __hash__(self) -> int:
        return id(self.s.solution)


@lru_cache(maxsize=2)
def _facts(of: _Same) -> Facts | None:
    s = of.s
    if s.solution is None:
        return None
    limits, captured = s.procedure.acceptance, len(s.state.poses)
    return facts_of(s.solution, checks=s.cross_checks, limits=limits, captured=captured)


@lru_cache(maxsize=2)
def _subject(of: _Same) -> Subject:
    s = of.s
    return Subject(
        name=s.folder.name,
        procedure=s.procedure,
        state=s.state,
        solution=s.solution,
        checks=s.cross_checks,
        simulated=s.simulated,
    )


ROLES = {"found": "bold"}
"""Roles of figures that the screen maps to another style."""


def table_spans(table: FactTable) -> tuple[list[Line], list[Line]]:
    """Return head and body of a table without the page-only columns."""
    table = table.brief
    heads, rows = placed(table, " ")
    body = [
        line(
            *(
                (
                    f" {words}",
                    ROLES.get(cell.role, cell.role) if isinstance(cell, Figure) else "text",
                )
                for words, cell in zip(words_of, row, strict=True)
            )
        )
        for words_of, row in zip(rows, table.rows, strict=True)
    ]
    return [line((" " + " ".join(cells), "header")) for cells in heads], body


def headline_spans(headlines: Sequence[Headline], width: int) -> Line:
    """Return headlines side by side, the last ones without their notes where these do not fit."""
    row = ""
    for with_note in range(len(headlines), -1, -1):
        said = [h.text if k < with_note else h.figure_text for k, h in enumerate(headlines)]
        row = "   " + "   ".join(said)
        if len(row) <= width:
            break
    return line(row)

"""Facts as lines of spans for a terminal's panels, built once a calibration. Decides no digit; knows no widget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from operator_app.calibration.checks import Checks
from operator_app.calibration.solution import Solution
from operator_app.config.procedure import AcceptanceLimits
from operator_app.report.facts import Facts, facts_of
from operator_app.report.spans import Line, line
from operator_app.report.table import Headline, Table
from operator_app.report.text import placed
from operator_app.session.snapshot import SessionSnapshot
from operator_app.units.figure import Figure


def facts_on(s: SessionSnapshot) -> Facts | None:
    """Return the facts of the calibration on a snapshot; None where there is none."""
    if s.solution is None:
        return None
    return _facts(_Same(s.solution, s.checks_of_it, s.procedure.acceptance, len(s.state.poses)))


@dataclass(frozen=True, slots=True, eq=False)
class _Same:
    """What facts are made of, known again by being the same objects: pictures come often."""

    solution: Solution
    checks: Checks | None
    limits: AcceptanceLimits
    captured: int

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self._parts() == other._parts()

    def __hash__(self) -> int:
        return hash(self._parts())

    def _parts(self) -> tuple[int, int, AcceptanceLimits, int]:
        return id(self.solution), id(self.checks), self.limits, self.captured


@lru_cache(maxsize=2)
def _facts(of: _Same) -> Facts:
    return facts_of(of.solution, checks=of.checks, limits=of.limits, captured=of.captured)


ROLES = {"found": "bold"}
"""Roles of figures that a screen shows otherwise."""


def table_spans(table: Table) -> tuple[list[Line], list[Line]]:
    """Return head and body of a table without what only a page has room for."""
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

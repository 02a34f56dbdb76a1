"""Tables of what the verdict rests on: what may be wrong, and the tests. Knows no renderer."""

from __future__ import annotations

from operator_app.calibration.result import Solution
from operator_app.report.table import Column, FactTable, figures, words
from operator_app.units.figure import SHARE, Figure


def causes_table(solution: Solution) -> FactTable | None:
    """Return what may be wrong, the most probable first; the sentences are page and JSON's affair."""
    rows = tuple(
        (
            cause.code,
            Figure(cause.probability, SHARE, digits=2, role="warn" if cause.blocking else "text"),
            "it is refused for this" if cause.blocking else "a warning",
            cause.text,
            cause.remedy,
        )
        for cause in solution.causes
    )
    return None if not rows else FactTable(
        ident="causes",
        title="What may be wrong, by probability",
        columns=(
            *words("cause"),
            *figures("probability", unit=SHARE.unit),
            *words(""),
            Column("what", words=True, detail=True),
            Column("what to do", words=True, detail=True),
        ),
        rows=rows,
    )  # fmt: skip


def tests_table(solution: Solution) -> FactTable | None:
    """Return every test that the verdict rests on; those that fired are marked."""
    rows = tuple(
        (
            t.code,
            Figure(t.statistic, role="warn" if t.fires else "text"),
            Figure(t.threshold),
            Figure(t.false_alarm, digits=2),
        )
        for t in solution.judgement.tests
    )
    return None if not rows else FactTable(
        ident="tests",
        title="Tests that the verdict rests on (no unit)",
        columns=(*words("test"), *figures("statistic", "threshold", "false alarm")),
        rows=rows,
        note="A test fires (▲) above its threshold; false alarm is how often a sound set fires it.",
        detail=True,
    )  # fmt: skip

"""Facts as text and tables for a terminal of 80 columns, and as lines of spans for the terminal app."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from itertools import groupby, zip_longest
from typing import TYPE_CHECKING

from operator_app.report.spans import Line, line
from operator_app.report.table import FactTable, Headline, shown
from operator_app.safe_output import sanitized
from operator_app.units import Figure, joints_named, names

if TYPE_CHECKING:
    from operator_app.messages.finding import Finding
    from operator_app.report.facts import Facts
    from solver.errors import UnidentifiableError

WIDTH = 80


def facts_text(facts: Facts, *, failed: str = "") -> str:
    """Return the result of a calibration as text, the most important facts first.

    `failed`: file of new poses that disagree with the calibration; the first line names it. Empty if there is none.
    """
    blocks = [
        verdict_text(facts, failed=failed),
        *(table_text(table) for table in facts.tables if not table.detail),
        warnings_text(
            (n for n in facts.solution.warnings if n.code not in _codes_in_verdict(facts)),
            mark="-" if facts.notices_are_notes else "!",
        ),
    ]
    return "\n\n".join(block for block in blocks if block)


def verdict_text(facts: Facts, *, failed: str = "") -> str:
    """Return verdict and reasons; the first line also names `failed`, a file of poses that contradict the result."""
    reasons = facts.solution.reasons
    head = facts.verdict.upper()
    if failed:
        so = "BUT" if facts.solution.accepted else "AND"
        head += f", {so} DOES NOT HOLD for {failed} (the test is at the end)"
    head += ":"
    if facts.solution.accepted:
        codes = _codes_in_verdict(facts)
        reasons = tuple(n.sentence for n in facts.solution.warnings if n.code in codes)
        head = f"{head} {facts.limits_met}.{' Possible causes of error:' if reasons else ''}"
    return "\n".join((paragraph(head), *(paragraph(f"- {text}", indent=2) for text in reasons)))


def _codes_in_verdict(facts: Facts) -> set[str]:
    return {c.code for c in facts.solution.causes if facts.solution.accepted or c.blocking}


def table_text(table: FactTable) -> str:
    """Return a table under its title, with its note below."""
    rows = table_lines(table)
    if max(map(len, rows), default=0) > WIDTH:
        rows = table_lines(table, gap=" ")
    lines = [table.title, *rows]
    return "\n".join([*lines, paragraph(table.note)] if table.note else lines)


def table_lines(table: FactTable, gap: str = "  ", margin: str = "  ") -> list[str]:
    """Return the header and rows of a table as lines, without columns that only the page shows."""
    heads, rows = placed(table.brief, gap)
    return [(margin + gap.join(cells)).rstrip() for cells in (*heads, *rows)]


def placed(table: FactTable, gap: str) -> tuple[list[list[str]], list[list[str]]]:
    """Return the header rows (groups above titles) and the body rows, as padded cells."""
    if not table.rows:
        return [], []
    columns = table.columns
    heads = [f"{c.title} [{c.unit}]" if c.unit else c.title for c in columns]
    body = [[sanitized(shown(cell)) for cell in row] for row in table.rows]
    widths = [max(map(len, column)) for column in zip(heads, *body, strict=True)]
    above: list[str] = []
    grouped = 0
    for group, members in groupby(range(len(columns)), key=lambda k: columns[k].group):
        first, *others = members
        if not group:
            above += [" " * width for width in widths[first : first + 1 + len(others)]]
            continue
        span = sum(widths[k] + len(gap) for k in others) + widths[first]
        widths[first] += max(0, len(group) - span)
        above.append(group.center(max(span, len(group))))
        grouped = len(above)
    puts = [str.ljust if column.words else str.rjust for column in columns]
    titles, *rows = (
        [put(cell, width) for put, cell, width in zip(puts, cells, widths, strict=True)]
        for cells in (heads, *body)
    )
    return [above[:grouped], titles] if grouped else [titles], rows


ROLES = {"found": "bold"}
"""Role of a figure in the terminal app, by its role in the table; roles that are not listed stay the same."""


def table_spans(table: FactTable) -> tuple[list[Line], list[Line]]:
    """Return the header and body of a table as spans, without the columns that only the HTML page has."""
    table = table.brief
    heads, rows = placed(table, " ")
    body = []
    for texts, cells in zip(rows, table.rows, strict=True):
        roles = (ROLES.get(c.role, c.role) if isinstance(c, Figure) else "text" for c in cells)
        body.append(tuple((f" {text}", role) for text, role in zip(texts, roles, strict=True)))
    return [line((" " + " ".join(cells), "header")) for cells in heads], body


def headline_spans(headlines: Sequence[Headline], width: int) -> Line:
    """Return headlines in one line. If it is wider than `width`, the last headlines lose their notes until it fits."""
    row = ""
    for with_note in range(len(headlines), -1, -1):
        texts = [h.text if k < with_note else h.figure_text for k, h in enumerate(headlines)]
        row = "   " + "   ".join(texts)
        if len(row) <= width:
            break
    return line(row)


def warnings_text(notices: Iterable[Finding], mark: str = "!") -> str:
    """Return one paragraph for each notice, beginning with `mark`: ``!`` for warnings, ``-`` for notes."""
    return "\n".join(warning(n.sentence, mark) for n in notices)


def warning(text: str, mark: str = "!") -> str:
    """Return a warning as a paragraph with a mark."""
    return paragraph(f"{mark} {text}", indent=2)


MANY_JOINTS = 2
"""If more joints than this are immobile, the poses are the cause and not the fixture."""


def unidentifiable_text(error: UnidentifiableError) -> str:
    """Return text on why a pose set does not determine every parameter, and on the remedy."""
    directions = error.directions
    joints = sorted({j for d in directions for j in d.immobile_joints})
    if len(joints) > MANY_JOINTS:
        remedy = "take poses in which every joint moves through as much of its range as the fixture allows."
    elif joints:
        several = len(joints) > 1
        remedy = (
            f"take poses in which {joints_named(joints)} move{'s' * (not several)}, in another fixture if this "
            "one does not allow it (a rigid one fixes the elbow, a hinge frees it), or fix "
            f"{names(f'theta_off_{j}' for j in joints)} at nominal: --drop-unidentifiable of solve and import "
            f"does, or leave {'them' if several else 'it'} out of the free entries of the arm file."
        )
    else:
        remedy = (
            "take poses that differ more from each other, or fix one parameter of each line at its nominal value: "
            "--drop-unidentifiable of solve and import chooses them, or leave them out of the free "
            "entries of the arm file."
        )
    # The note states the cause if it is known: a stuck sensor, or too few poses.
    causes = [*([error.note] if error.note else []), *map(str, directions)]
    head = "Not identifiable: these poses cannot determine every parameter."
    return "\n".join([head, *map(warning, causes), paragraph(f"What to do: {remedy}")])


def aligned(rows: Sequence[Sequence[str]], *, left: bool = False) -> str:
    """Return rows as text in aligned columns: all but the first are aligned to the right, unless `left`."""
    columns = list(zip_longest(*(map(sanitized, row) for row in rows), fillvalue=""))
    for k, cells in enumerate(columns):
        width = max(map(len, cells))
        put = str.ljust if left or k == 0 else str.rjust
        columns[k] = tuple(put(cell, width) for cell in cells)
    return "\n".join(("  " + "  ".join(row)).rstrip() for row in zip(*columns, strict=True))


def paragraph(text: str, indent: int = 0, width: int = WIDTH) -> str:
    """Wrap text to `width` characters, with `indent` spaces before continuation lines."""
    return textwrap.fill(text, width, subsequent_indent=" " * indent, break_long_words=False)

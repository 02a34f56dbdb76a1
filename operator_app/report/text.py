"""Facts in words and tables, for a terminal of 80 columns. Computes nothing, decides nothing, prints nothing."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from operator_app.calibration.judgement import Notice
from operator_app.report.facts import Facts
from operator_app.report.table import Column, Table, shown
from operator_app.words_out import harmless
from solver.errors import UnidentifiableDirection

WIDTH = 80


def facts_text(facts: Facts) -> str:
    """Return everything an operator should read after a calibration, most important first."""
    blocks = [
        verdict_text(facts),
        *(table_text(table) for table in facts.tables if not table.detail),
        warnings_text(facts.notices),
    ]
    return "\n\n".join(block for block in blocks if block)


def verdict_text(facts: Facts) -> str:
    """Return the verdict with its reasons."""
    if facts.accepted:
        return f"{facts.verdict.upper()}: the calibration meets its limits."
    reasons = (paragraph(f"- {reason}", indent=2) for reason in facts.reasons)
    return "\n".join((f"{facts.verdict.upper()}:", *reasons))


def table_text(table: Table) -> str:
    """Return a table under its title, its note below."""
    rows = table_lines(table)
    if max(map(len, rows), default=0) > WIDTH:
        rows = table_lines(table, gap=" ")
    lines = [table.title, *rows]
    return "\n".join([*lines, paragraph(table.note)] if table.note else lines)


def table_lines(table: Table, gap: str = "  ", margin: str = "  ") -> list[str]:
    """Return head and rows of a table without what only a page has room for."""
    heads, rows = placed(table.brief, gap)
    return [(margin + gap.join(cells)).rstrip() for cells in (*heads, *rows)]


def placed(table: Table, gap: str) -> tuple[list[list[str]], list[list[str]]]:
    """Return the head's rows, groups above titles, and the body's, every cell in its place."""
    if not table.rows:
        return [], []
    columns, groups = table.columns, _groups(table.columns)
    heads = [f"{c.title} [{c.unit}]" if c.unit else c.title for c in columns]
    body = [[harmless(shown(cell)) for cell in row] for row in table.rows]
    widths = [max(map(len, column)) for column in zip(heads, *body, strict=True)]
    for first, last in groups:
        taken = sum(widths[first:last]) + len(gap) * (last - first - 1)
        widths[first] += max(0, len(columns[first].group) - taken)
    above, k = [], 0
    for first, last in groups:
        above += [" " * width for width in widths[k:first]]
        taken = sum(widths[first:last]) + len(gap) * (last - first - 1)
        above.append(columns[first].group.center(taken))
        k = last
    titles, *rows = (
        [
            cell.ljust(width) if column.words else cell.rjust(width)
            for cell, width, column in zip(cells, widths, columns, strict=True)
        ]
        for cells in (heads, *body)
    )
    return [above, titles] if groups else [titles], rows


def _groups(columns: Sequence[Column]) -> list[tuple[int, int]]:
    """First column of every group, and the one after its last."""
    starts = [
        k
        for k, column in enumerate(columns)
        if column.group and (k == 0 or columns[k - 1].group != column.group)
    ]
    return [
        (k, k + sum(column.group == columns[k].group for column in columns[k:])) for k in starts
    ]


def warnings_text(notices: Iterable[Notice]) -> str:
    """Return warnings, one paragraph each."""
    return "\n".join(paragraph(f"! {n.text}", indent=2) for n in notices)


def unidentifiable_text(directions: Sequence[UnidentifiableDirection]) -> str:
    """Return why a pose set cannot give what was asked for."""
    joints = sorted({j for d in directions for j in d.immobile_joints})
    which = ", ".join(str(j) for j in joints)
    remedy = (
        f"use a fixture in which joint {which} moves (the hinge), or leave theta_off_{which} out of "
        "the free entries of the arm file."
        if joints
        else "take poses that differ more, or hold one parameter of each line at its nominal value: "
        "--drop-unidentifiable of solve and import chooses them, or leave them out of the free "
        "entries of the arm file."
    )
    lines = ["Not identifiable: these poses cannot determine every parameter."]
    lines += [paragraph(f"! {direction}", indent=2) for direction in directions]
    return "\n".join([*lines, paragraph(f"What to do: {remedy}")])


def aligned(rows: Sequence[Sequence[str]], gap: str = "  ") -> str:
    """Return rows as columns: the first column to the left, all others to the right."""
    count = max(len(row) for row in rows)
    full = [[*map(harmless, row), *[""] * (count - len(row))] for row in rows]
    widths = [max(len(row[k]) for row in full) for k in range(count)]
    lines = []
    for row in full:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append(("  " + gap.join(cells)).rstrip())
    return "\n".join(lines)


def paragraph(text: str, indent: int = 0) -> str:
    """Wrap one sentence or more to the width of a terminal."""
    return textwrap.fill(text, WIDTH, subsequent_indent=" " * indent, break_long_words=False)

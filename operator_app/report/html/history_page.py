"""The history of an arm as one self-contained HTML page. No script, no external resource."""

from __future__ import annotations

import math

from operator_app.calibration.history import ArmHistory, EntryHistory
from operator_app.report.html.markup import Html, Section, bullets, element, figure, plots, remark
from operator_app.report.html.page import document
from operator_app.report.html.table import table_html
from operator_app.report.plots.plot import Layer, Marks, Picture, Polyline, axis
from operator_app.report.plots.svg import plot
from operator_app.report.results.history import (
    HOW,
    checks_lines,
    due_text,
    entries_table,
    quantity,
    sessions_table,
    title_of,
    verdict_text,
)


def history_html(found: ArmHistory) -> bytes:
    """Return the page, UTF-8."""
    last = found.calibrations[-1].document
    title = f"{last.arm.model} {last.arm.serial}: history"
    sections = [
        Section(
            ident=f"part-{k}",
            title=title_of(part),
            content=(
                *([plots(_chart(part, j) for j in range(len(part.names)))] if part.several else []),
                table_html(entries_table(part)),
                table_html(sessions_table(part)),
            ),
        )
        for k, part in enumerate(found.parts, 1)
    ]
    notes = [*checks_lines(found), *(f"{n} left out: {why}" for n, why in found.left_out)]
    how = Section(
        ident="how", title="Verifications and method", content=(bullets(notes), remark(HOW))
    )
    good = not found.shifted
    verdict = element(
        "div",
        *(element("p", line.strip()) for line in verdict_text(found).split("\n- ")),
        element("p", due_text(found)),
        class_="verdict" if good else "verdict no",
    )
    body = element(
        "body",
        element("header", element("h1", title), verdict),
        element("main", *(section.html for section in [*sections, how]), id="content"),
    )
    return document(title, body)


def _chart(part: EntryHistory, j: int) -> Html:
    """Draw one entry over the sessions, with both kinds of limits where there are any."""
    name, chart = part.names[j], part.chart
    unit = quantity(name)
    count = len(part.calibrations)
    sessions = [float(k) for k in range(1, count + 1)]
    values = (unit.per_si * part.values[:, j]).tolist()
    layers: list[Layer] = []
    heights = list(values)
    for half, style, label in (
        (chart.shewhart, "a", "Shewhart"),
        (chart.ewma_limit, "dashed", "EWMA limits"),
    ):
        for sign in (-1.0, 1.0):
            limit = (unit.per_si * (chart.centre[:, j] + sign * half[:, j])).tolist()
            known = [k for k in range(count) if math.isfinite(limit[k])]
            heights += [limit[k] for k in known]
            shown = label if sign > 0.0 else ""
            x, y = [sessions[k] for k in known], [limit[k] for k in known]
            if known:
                layers.append(Polyline(x=x, y=y, class_=style, label=shown))
    tips = [
        f"{c.session}: {v:.4f} {unit.unit}" for c, v in zip(part.calibrations, values, strict=True)
    ]
    layers.append(Marks(x=sessions, y=values, label="session", tips=tips))
    ewma = (unit.per_si * chart.ewma[:, j]).tolist()
    layers.append(Marks(x=sessions, y=ewma, shape="triangle", class_="b", label="EWMA"))
    picture = Picture(
        ident=f"{part.side.name.lower()}-{name}",
        title=f"{name} by session, in {unit.unit}",
        description="Dots are sessions, triangles the weighted mean of recent ones; lines are their limits.",
        x=axis("session", sessions, whole=True),
        y=axis(name, heights, unit=unit.unit),
        layers=layers,
    )
    return figure(picture.title, plot(picture))

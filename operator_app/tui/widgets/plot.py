"""A picture in braille, and a row of bars."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from operator_app.report.plots.braille import Canvas
from operator_app.report.plots.plot import Axis, Band, Marks, Picture, Polyline, Ribbon
from operator_app.report.spans import Line as Row
from operator_app.report.spans import Span

LABEL = 9
"""Width in cells of the vertical axis and its numbers."""
ROLES = {"a": "text", "b": "accent", "c": "warn", "d": "dim"}
"""Roles of the classes of lines and marks."""


def plot(of: Picture, width: int, height: int, *, ascii_only: bool) -> list[Row]:
    """Return a picture of `height` lines; empty when it would not fit."""
    if width < LABEL + 10 or height < 6:
        return []
    x, y = of.x, of.y
    canvas = Canvas(width - LABEL - 1, height - 3, ascii_only=ascii_only)
    left, right, top, bottom = 1.0, canvas.width - 3.0, 0.0, canvas.height - 1.0
    labels = _ticks(y, canvas, bottom, top)
    bands = [layer for layer in of.layers if isinstance(layer, Band)]
    for level in (0.0, *(v for band in bands for v in (band.low, band.high))):
        if y.low <= level <= y.high:
            at = y.place(level, bottom, top)
            canvas.segment(0, at, canvas.width - 1, at, "dim", every=3)
    for layer in of.layers:
        if isinstance(layer, Band | Ribbon):
            continue
        places = [
            (x.place(a, left, right), y.place(b, bottom, top))
            for a, b in zip(layer.x, layer.y, strict=True)
            if math.isfinite(a) and math.isfinite(b)
        ]
        if isinstance(layer, Polyline):
            for one, other in pairwise(places):
                canvas.segment(*one, *other, ROLES.get(layer.class_, "text"))
        if isinstance(layer, Marks):
            for place in places:
                canvas.blob(*place, ROLES[layer.class_])
    named = "".join(
        f", {'-- ' if band.high <= y.high else ''}{band.label}" for band in bands if band.label
    )
    return [
        ((f" {y.title}{named}"[:width], "dim"),),
        *(
            ((f"{labels.get(k, ''):>{LABEL - 1}} │", "dim"), *row)
            for k, row in enumerate(canvas.lines())
        ),
        ((" " * LABEL + "└" + "─" * (width - LABEL - 1), "dim"),),
        ((_below(x, width), "dim"),),
    ]


def _ticks(y: Axis, canvas: Canvas, bottom: float, top: float) -> dict[int, str]:
    """Texts of the ticks by the row in which their values are drawn, none directly below another."""
    found: dict[int, str] = {}
    for value, text in zip(y.ticks, y.tick_texts, strict=True):
        row = canvas.row(y.place(value, bottom, top))
        if not {row - 1, row, row + 1} & found.keys():
            found[row] = text
    return found


def _below(x: Axis, width: int) -> str:
    """Line of the horizontal axis: first and last tick, the title between them."""
    room = width - LABEL - 1
    cells = [" "] * room
    first, last = x.tick_texts[0], x.tick_texts[-1]
    begin = int(x.place(x.ticks[0], 0, room - 1))
    end = min(room, max(begin + len(first) + 1 + len(last), int(x.place(x.ticks[-1], 0, room)) + 1))
    cells[begin : begin + len(first)] = first
    cells[end - len(last) : end] = last
    free = max(0, end - len(last) - begin - len(first))
    title = x.title if len(x.title) + 2 <= free else f"[{x.unit}]" if x.unit else ""
    cells[begin + len(first) : end - len(last)] = title.center(free)[:free]
    return " " * (LABEL + 1) + "".join(cells)[:room]


SPARKS = "▁▂▃▄▅▆▇█"
MOST = 30.0
"""Largest ratio of the highest bar to the lowest: one bad first value does not flatten the rest."""


def sparkline(values: Sequence[float], width: int) -> Span:
    """A row of bars over all values, the newest at the right, on a log scale from the lowest to the highest."""
    last, cells = len(values) - 1, max(1, min(width, len(values)))
    some = [values[round(k * last / max(1, cells - 1))] for k in range(cells)]
    finite = [v for v in some if math.isfinite(v) and v > 0.0] or [1.0]
    low = min(finite)
    decades = math.log10(min(max(finite) / low, MOST))
    shares = [
        min(1.0, math.log10(max(v / low, 1.0)) / decades) if math.isfinite(v) else 1.0
        for v in some
    ] if decades > 0.0 else [0.0] * cells  # fmt: skip
    return ("".join(SPARKS[int(share * 7.99)] for share in shares), "dim")

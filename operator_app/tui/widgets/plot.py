"""Points over an axis, in braille: residuals by pose, by joint, a sensor's curve. Knows numbers only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from operator_app.report.braille import Canvas
from operator_app.report.spans import Line, Span

LABEL = 9
"""Cells of the vertical axis and its numbers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Points of one kind, in one role."""

    x: Sequence[float]
    y: Sequence[float]
    role: str = "text"


@dataclass(frozen=True, slots=True, kw_only=True)
class Axes:
    """What the axes say: quantities with units, and horizontal lines worth drawing."""

    x_label: str
    y_label: str
    levels: tuple[float, ...] = (0.0,)
    logarithmic: bool = False


def plot(
    series: Sequence[Series], axes: Axes, width: int, height: int, *, ascii_only: bool
) -> list[Line]:
    """Return a plot of `height` lines; empty when it would not fit."""
    xs = [v for s in series for v in s.x]
    ys = [_scaled(v, axes) for s in series for v in s.y]
    if not xs or width < LABEL + 10 or height < 6:
        return []
    levels = [_scaled(v, axes) for v in axes.levels]
    low, high = min([*ys, *levels]), max([*ys, *levels])
    pad = 0.05 * (high - low) or max(abs(high), 1e-12) * 0.1
    low, high = (low if low == 0.0 else low - pad), high + pad
    x_low, x_high = min(xs), max(xs)
    if x_high == x_low:
        x_low, x_high = x_low - 0.5, x_high + 0.5
    canvas = Canvas(width - LABEL - 1, height - 3, ascii_only=ascii_only)

    def place(x: float, y: float) -> tuple[float, float]:
        return (
            1 + (x - x_low) / (x_high - x_low) * (canvas.width - 4),
            (high - y) / (high - low) * (canvas.height - 1),
        )

    for level in levels:
        _, y = place(x_low, level)
        canvas.segment(0, y, canvas.width - 1, y, "dim", every=3)
    for one in series:
        for x, y in zip(one.x, one.y, strict=True):
            canvas.blob(*place(x, _scaled(y, axes)), one.role)
    rows: list[Line] = [((f" {axes.y_label}"[:width], "dim"),)]
    picture = canvas.lines()
    last = len(picture) - 1
    labels = {
        k: 10**value if axes.logarithmic else value
        for k in (0, last // 2, last)
        for value in [high - (k + 0.5) / len(picture) * (high - low)]
    }
    # A line that is drawn says its own value, and no other number stands next to it.
    for level, value in zip(levels, axes.levels, strict=True):
        row_of = min(last, max(0, int(place(x_low, level)[1] // 4)))
        labels = {k: v for k, v in labels.items() if abs(k - row_of) > 1 or v in axes.levels}
        labels[row_of] = value
    for k, row in enumerate(picture):
        label = _number(labels[k]) if k in labels else ""
        rows.append(((f"{label:>{LABEL - 1}} │", "dim"), *row))
    rows.append(((" " * LABEL + "└" + "─" * (width - LABEL - 1), "dim"),))
    left, right = _number(x_low), _number(x_high)
    middle = axes.x_label
    room = width - LABEL - 1 - len(left) - len(right)
    rows.append(
        ((" " * (LABEL + 1) + left + middle.center(max(room, 0))[: max(room, 0)] + right, "dim"),)
    )
    return rows


def _scaled(value: float, axes: Axes) -> float:
    return math.log10(max(value, 1e-30)) if axes.logarithmic else value


def _number(value: float) -> str:
    """At most seven characters."""
    size = abs(value)
    if size >= 1e5 or (0.0 < size < 1e-3):
        return f"{value:.0e}"
    return f"{value:.0f}" if size >= 100 else f"{value:.3g}"


SPARKS = "▁▂▃▄▅▆▇█"


def sparkline(values: Sequence[float], width: int) -> Span:
    """A row of bars, logarithmic, the newest at the right."""
    recent = [math.log10(max(v, 1.0)) if math.isfinite(v) else 4.0 for v in values[-width:]]
    if not recent:
        return ("", "dim")
    low, high = min(recent), max(*recent, min(recent) + 0.3)
    bars = "".join(SPARKS[int((v - low) / (high - low) * 7.99)] for v in recent)
    return (bars, "dim")

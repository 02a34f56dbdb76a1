"""Rows of small plots, one a joint: values over poses, and ranges with what was covered of them.

Like `svg`, for which it draws; knows no calibration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from operator_app.report.html.markup import Html, element
from operator_app.report.plots.plot import Axis
from operator_app.report.plots.svg import (
    RIGHT,
    WIDTH,
    label,
    mark,
    picture,
    segment,
)
from operator_app.units.numbers import fixed, significant

ROW = 34.0
NAME = 74.0
SCALE = 40.0
HEAD, FOOT = 16.0, 32.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """One row of values about zero.

    Attributes
    ----------
    name
        What the row is.
    values
        One a position on the shared x axis.
    band
        Half-width of the shaded band about zero.
    odd
        Whether the row is to catch the eye.
    """

    name: str
    values: Sequence[float]
    band: float
    odd: bool = False


def strips(
    *,
    ident: str,
    title: str,
    description: str,
    unit: str,
    x: Axis,
    at: Sequence[float],
    rows: Sequence[Strip],
) -> Html:
    """Draw each row on a scale of its own, written at its right, over one x axis."""
    right = WIDTH - RIGHT - SCALE
    height = HEAD + ROW * len(rows) + FOOT
    parts = [label(f"full scale [±{unit}]", WIDTH - 2.0, 10.0, class_="axis", anchor="end")]
    for k, row in enumerate(rows):
        top = HEAD + ROW * k
        middle, half = top + 0.5 * ROW, 0.5 * ROW - 3.0
        reach = max([abs(v) for v in row.values if math.isfinite(v)] + [row.band, 1e-12])
        band = half * row.band / reach
        parts.append(
            element(
                "rect",
                x=NAME,
                y=middle - band,
                width=right - NAME,
                height=2.0 * band,
                class_="band",
            )
        )
        parts.append(segment(NAME, middle, right, middle, "zero"))
        parts.append(segment(2.0, top + ROW, WIDTH - 2.0, top + ROW, "grid"))
        parts.append(label(row.name, 2.0, middle + 3.6, class_="legend"))
        parts.append(label(significant(reach, 2), WIDTH - 2.0, middle + 3.6, anchor="end"))
        colour = "c" if row.odd else "a"
        for a, value in zip(at, row.values, strict=True):
            here = x.place(a, NAME, right)
            y = middle - half * value / reach
            parts.append(segment(here, middle, here, y, f"stem {colour}"))
            parts.append(mark("dot", here, y, 1.7, colour))
    foot = HEAD + ROW * len(rows)
    for value, words in zip(x.ticks, x.tick_texts, strict=True):
        here = x.place(value, NAME, right)
        parts.append(segment(here, foot, here, foot + 3.5, "frame"))
        parts.append(label(words, here, foot + 14.0, anchor="middle"))
    parts.append(label(x.title, right, height - 3.0, class_="axis", anchor="end"))
    return picture(ident, title, description, height, parts)


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """One row of a range chart: from `low` to `high`, with `values` in it."""

    name: str
    low: float
    high: float
    values: Sequence[float]

    @property
    def covered(self) -> float:
        """Share of the range between the outermost values."""
        return (max(self.values) - min(self.values)) / (self.high - self.low)


def ranges(*, ident: str, title: str, description: str, unit: str, rows: Sequence[Range]) -> Html:
    """Draw each range as a bar with a tick a value; its ends are written below it.

    Bars have the full width, less what values beyond the range need.
    """
    right = WIDTH - RIGHT - SCALE
    height = HEAD + ROW * len(rows) + 4.0
    parts = [
        label(f"end of range [{unit}]", NAME, 10.0, class_="axis"),
        label("covered [%]", WIDTH - 2.0, 10.0, class_="axis", anchor="end"),
    ]
    for k, row in enumerate(rows):
        top = HEAD + ROW * k + 4.0

        scale = Axis(
            label="",
            unit=unit,
            low=min(row.low, *row.values),
            high=max(row.high, *row.values),
            ticks=(),
        )
        low, high = (scale.place(v, NAME, right) for v in (row.low, row.high))
        start, end = (scale.place(v, NAME, right) for v in (min(row.values), max(row.values)))
        parts += [
            label(row.name, 2.0, top + 9.0, class_="legend"),
            element(
                "rect", x=start, y=top, width=max(0.8, end - start), height=11.0, class_="band"
            ),
            element("rect", x=low, y=top, width=high - low, height=11.0, class_="range"),
        ]
        marks = (scale.place(v, NAME, right) for v in row.values)
        parts += [segment(x, top, x, top + 11.0, "rug") for x in marks]
        parts += [
            label(fixed(row.low, 0), low, top + 22.0),
            label(fixed(row.high, 0), high, top + 22.0, anchor="end"),
            label(fixed(100.0 * row.covered, 0), WIDTH - 2.0, top + 9.0, anchor="end"),
        ]
    return picture(ident, title, description, height, parts)

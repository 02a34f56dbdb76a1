"""Plots as inline SVG: axes with units, round ticks, bands, lines and marks. Knows no calibration.

Plots are drawn for the width of a phone and enlarged elsewhere. Colours and line styles are classes of
the page's style sheet, so that they follow its theme; marks differ in shape as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from operator_app.report.markup import Html, element, join
from operator_app.units.numbers import fixed, significant, typeset

WIDTH = 360.0
LEFT, RIGHT, TOP, BOTTOM = 46.0, 8.0, 22.0, 34.0
CHARACTER = 5.6
"""Mean width of a character of plot text."""

Shape = Literal["dot", "square", "triangle"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """A linear axis from `low` to `high` with its round `ticks`."""

    label: str
    unit: str
    low: float
    high: float
    ticks: tuple[float, ...]

    def place(self, value: float, start: float, end: float) -> float:
        """Where a value lies between the coordinates `start` (of low) and `end` (of high)."""
        return start + (value - self.low) / (self.high - self.low) * (end - start)

    @property
    def title(self) -> str:
        """Label with unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    @property
    def tick_texts(self) -> tuple[str, ...]:
        """All ticks with the same number of places."""
        step = self.ticks[1] - self.ticks[0] if len(self.ticks) > 1 else 1.0
        largest = max(abs(t) for t in self.ticks)
        if largest >= 1e5 or step < 1e-4:
            return tuple(significant(t, 2) for t in self.ticks)
        places = max(0, -math.floor(math.log10(step) + 1e-9))
        return tuple(fixed(t, places) for t in self.ticks)


def axis(
    label: str,
    values: Iterable[float],
    *,
    unit: str = "",
    ticks: int = 5,
    whole: bool = False,
    symmetric: bool = False,
) -> Axis:
    """Return an axis that holds all finite `values` with a little room and about so many ticks."""
    finite = [v for v in values if math.isfinite(v)]
    low, high = (min(finite), max(finite)) if finite else (0.0, 1.0)
    if symmetric:
        high = max(abs(low), abs(high))
        low = -high
    if high - low <= 1e-12 * max(abs(low), abs(high)) or high == low:
        margin = 0.0 if whole else max(0.5 * abs(high), 1e-9)
        low, high = low - margin, high + margin
    room = 0.5 if whole else 0.06 * (high - low)
    low, high = low - room, high + room
    step = _round_step((high - low) / ticks, whole=whole)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    marks = tuple(k * step + 0.0 for k in range(first, last + 1))
    return Axis(label=label, unit=unit, low=low, high=high, ticks=marks)


def _round_step(rough: float, *, whole: bool) -> float:
    """Return the 1, 2 or 5 times a power of ten next above `rough`."""
    if whole and rough <= 1.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(rough))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if rough <= m * power * (1.0 + 1e-9))


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """Shaded strip between two values of y."""

    low: float
    high: float
    label: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """Points joined by a line. `class_` is a line style: ``a``, ``b``, ``dashed``."""

    x: Sequence[float]
    y: Sequence[float]
    class_: str = "a"
    label: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """Points. `class_` is a colour: ``a``, ``b``, ``c``; `tips` say what each point is."""

    x: Sequence[float]
    y: Sequence[float]
    shape: Shape = "dot"
    class_: str = "a"
    label: str = ""
    tips: Sequence[str] = ()


Layer = Band | Line | Marks


def plot(
    *,
    ident: str,
    title: str,
    description: str,
    x: Axis,
    y: Axis,
    layers: Sequence[Layer],
    height: float = 196.0,
) -> Html:
    """Draw layers, first ones below, in one frame."""
    right, bottom = WIDTH - RIGHT, height - BOTTOM
    parts = [*_grid(x, y, right, bottom)]
    size = _mark_size(
        max((len(layer.x) for layer in layers if isinstance(layer, Marks)), default=0)
    )
    for layer in layers:
        if isinstance(layer, Band):
            parts.append(_band(layer, y, right, bottom))
        elif isinstance(layer, Line):
            points = " ".join(
                f"{x.place(a, LEFT, right):.1f},{y.place(b, bottom, TOP):.1f}"
                for a, b in zip(layer.x, layer.y, strict=True)
            )
            parts.append(element("polyline", points=points, class_=f"line {layer.class_}"))
        else:
            for k, (a, b) in enumerate(zip(layer.x, layer.y, strict=True)):
                if math.isfinite(a) and math.isfinite(b):
                    tip = layer.tips[k] if layer.tips else ""
                    centre = x.place(a, LEFT, right), y.place(b, bottom, TOP)
                    parts.append(mark(layer.shape, *centre, size, layer.class_, tip))
    parts.append(_legend(layers, right))
    parts.append(label(y.title, 2.0, 12.0, class_="axis"))
    parts.append(label(x.title, right, height - 3.0, class_="axis", anchor="end"))
    return picture(ident, title, description, height, parts)


def picture(ident: str, title: str, description: str, height: float, parts: Iterable[str]) -> Html:
    """Wrap drawn parts as an image with a name and a description for those who cannot see it."""
    return element(
        "svg",
        element("title", title, id=f"{ident}-t"),
        element("desc", description, id=f"{ident}-d"),
        *parts,
        viewBox=f"0 0 {WIDTH:g} {height:g}",
        role="img",
        aria_labelledby=f"{ident}-t {ident}-d",
        class_="plot",
    )


def mark(shape: Shape, x: float, y: float, r: float, class_: str, tip: str = "") -> Html:
    """Draw one mark, with a tooltip if there is something to say."""
    inside = [element("title", tip)] if tip else []
    name = f"mark {class_}"
    match shape:
        case "dot":
            return element("circle", *inside, cx=x, cy=y, r=r, class_=name)
        case "square":
            s = 0.88 * r
            return element(
                "rect", *inside, x=x - s, y=y - s, width=2.0 * s, height=2.0 * s, class_=name
            )
        case "triangle":
            s = 1.25 * r
            path = f"M{x:.1f} {y - s:.1f}l{s:.1f} {1.8 * s:.1f}h{-2.0 * s:.1f}z"
            return element("path", *inside, d=path, class_=name)


def label(
    words: str, x: float, y: float, *, class_: str = "tick", anchor: str | None = None
) -> Html:
    """Write text into a picture."""
    return element("text", typeset(words), x=x, y=y, class_=class_, text_anchor=anchor)


def segment(x1: float, y1: float, x2: float, y2: float, class_: str) -> Html:
    """Draw a straight line."""
    return element("line", x1=x1, y1=y1, x2=x2, y2=y2, class_=class_)


def _mark_size(count: int) -> float:
    return 2.6 if count <= 60 else 2.0 if count <= 150 else 1.4


def _grid(x: Axis, y: Axis, right: float, bottom: float) -> Iterable[Html]:
    for value, words in zip(y.ticks, y.tick_texts, strict=True):
        at = y.place(value, bottom, TOP)
        yield segment(LEFT, at, right, at, "zero" if value == 0.0 else "grid")
        yield label(words, LEFT - 5.0, at + 3.6, anchor="end")
    yield segment(LEFT, bottom, right, bottom, "frame")
    for value, words in zip(x.ticks, x.tick_texts, strict=True):
        at = x.place(value, LEFT, right)
        yield segment(at, bottom, at, bottom + 3.5, "frame")
        yield label(words, at, bottom + 14.0, anchor="middle")


def _band(layer: Band, y: Axis, right: float, bottom: float) -> Html:
    top = y.place(min(layer.high, y.high), bottom, TOP)
    base = y.place(max(layer.low, y.low), bottom, TOP)
    return element(
        "rect", x=LEFT, y=top, width=right - LEFT, height=max(0.0, base - top), class_="band"
    )


def _legend(layers: Sequence[Layer], right: float) -> Html:
    """Name the layers above the frame, from the right."""
    parts: list[Html] = []
    at = right
    for layer in reversed([layer for layer in layers if layer.label]):
        at -= CHARACTER * len(layer.label)
        parts.append(label(layer.label, at, 12.0, class_="legend"))
        at -= 9.0
        if isinstance(layer, Marks):
            parts.append(mark(layer.shape, at + 3.0, 8.5, 2.8, layer.class_))
        elif isinstance(layer, Line):
            at -= 8.0
            parts.append(segment(at, 8.5, at + 13.0, 8.5, f"line {layer.class_}"))
        else:
            at -= 4.0
            parts.append(element("rect", x=at, y=4.5, width=10.0, height=8.0, class_="band"))
        at -= 9.0
    return join(parts)

"""Pictures as inline SVG: frame, ticks, bands, lines and marks.

Plots are drawn for the width of a phone and enlarged on larger screens. Colours and line styles are classes of the
page's style sheet, so that they follow its theme; marks differ in shape as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from operator_app.report.html.markup import Html, element, figure, join
from operator_app.report.plots.plot import (
    Axis,
    Band,
    Layer,
    Marks,
    Picture,
    Polyline,
    Ribbon,
    Shape,
)
from operator_app.units import typeset

PLOT_WIDTH, HEIGHT = 360.0, 196.0
LEFT, RIGHT, TOP, BOTTOM = 46.0, 8.0, 22.0, 34.0
LARGEST_MARK = 5.0
"""Radius of a mark whose relative area (`Marks.sizes`) is 1, in the units of the picture."""
CHARACTER = 6.2
"""Mean width of a character of plot text, in the units of the picture."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """The elements of a drawn picture, `PLOT_WIDTH` wide and `height` high."""

    height: float
    parts: tuple[Html, ...]


def plot(of: Picture) -> Html:
    """Draw a picture as a complete SVG image."""
    drawn = draw(of)
    return picture(of.ident, of.title, of.description, drawn.height, drawn.parts)


def draw(of: Picture) -> Drawn:
    """Draw the layers of a picture in one frame, later ones on top."""
    x, y, layers = of.x, of.y, of.layers
    height = HEIGHT if of.aspect == 0.0 else (PLOT_WIDTH - LEFT - RIGHT) / of.aspect + TOP + BOTTOM
    right, bottom = PLOT_WIDTH - RIGHT, height - BOTTOM
    parts = [*_grid(x, y, right, bottom)]
    marks = max((len(layer.x) for layer in layers if isinstance(layer, Marks)), default=0)
    usual = 2.6 if marks <= 60 else 2.0 if marks <= 150 else 1.4
    for layer in layers:
        if isinstance(layer, Band):
            parts.append(_band(layer, y, right, bottom))
        elif isinstance(layer, Ribbon):
            around = [*zip(layer.x, layer.high, strict=True)]
            around += reversed([*zip(layer.x, layer.low, strict=True)])
            points = _points(around, x, y, right, bottom)
            parts.append(element("polygon", points=points, class_="ribbon"))
        elif isinstance(layer, Polyline):
            points = _points([*zip(layer.x, layer.y, strict=True)], x, y, right, bottom)
            parts.append(element("polyline", points=points, class_=f"line {layer.class_}"))
        else:
            for k, (a, b) in enumerate(zip(layer.x, layer.y, strict=True)):
                if math.isfinite(a) and math.isfinite(b):
                    tip = layer.tips[k] if layer.tips else ""
                    centre = x.place(a, LEFT, right), y.place(b, bottom, TOP)
                    size = LARGEST_MARK * math.sqrt(layer.sizes[k]) if layer.sizes else usual
                    parts.append(mark(layer.shape, *centre, size, layer.class_, tip))
    parts.append(_legend(layers, right))
    parts.append(label(y.title, 2.0, 12.0, class_="axis"))
    parts.append(label(x.title, right, height - 3.0, class_="axis", anchor="end"))
    return Drawn(height, tuple(parts))


def picture(ident: str, title: str, description: str, height: float, parts: Iterable[str]) -> Html:
    """Return an SVG image of drawn parts, with a title and a description for screen readers."""
    return element(
        "svg",
        element("title", title, id=f"{ident}-t"),
        element("desc", description, id=f"{ident}-d"),
        *parts,
        viewBox=f"0 0 {PLOT_WIDTH:g} {height:g}",
        role="img",
        aria_labelledby=f"{ident}-t {ident}-d",
        class_="plot",
    )


def mark(shape: Shape, x: float, y: float, r: float, class_: str, tip: str = "") -> Html:
    """Draw one mark; if `tip` is not empty, the mark has this tooltip."""
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
    text: str, x: float, y: float, *, class_: str = "tick", anchor: str | None = None
) -> Html:
    """Return text at a point of a picture."""
    return element("text", typeset(text), x=x, y=y, class_=class_, text_anchor=anchor)


def segment(x1: float, y1: float, x2: float, y2: float, class_: str) -> Html:
    """Draw a straight line."""
    return element("line", x1=x1, y1=y1, x2=x2, y2=y2, class_=class_)


def _grid(x: Axis, y: Axis, right: float, bottom: float) -> Iterable[Html]:
    for value, tick_text in zip(y.ticks, y.tick_texts, strict=True):
        at = y.place(value, bottom, TOP)
        yield segment(LEFT, at, right, at, "zero" if value == 0.0 else "grid")
        yield label(tick_text, LEFT - 5.0, at + 3.6, anchor="end")
    yield segment(LEFT, bottom, right, bottom, "frame")
    for value, tick_text in zip(x.ticks, x.tick_texts, strict=True):
        at = x.place(value, LEFT, right)
        yield segment(at, bottom, at, bottom + 3.5, "frame")
        yield label(tick_text, at, bottom + 14.0, anchor="middle")


def _points(
    places: Iterable[tuple[float, float]], x: Axis, y: Axis, right: float, bottom: float
) -> str:
    return " ".join(
        f"{x.place(a, LEFT, right):.1f},{y.place(b, bottom, TOP):.1f}" for a, b in places
    )


def _band(layer: Band, y: Axis, right: float, bottom: float) -> Html:
    top = y.place(min(layer.high, y.high), bottom, TOP)
    base = y.place(max(layer.low, y.low), bottom, TOP)
    return element(
        "rect", x=LEFT, y=top, width=right - LEFT, height=max(0.0, base - top), class_="band"
    )


def _legend(layers: Sequence[Layer], right: float) -> Html:
    """Return the legend, above the frame: a sign and a label for each layer, right-aligned."""
    parts: list[Html] = []
    at = right
    for layer in reversed([layer for layer in layers if layer.label]):
        at -= CHARACTER * len(layer.label)
        parts.append(label(layer.label, at, 12.0, class_="legend"))
        at -= 9.0
        if isinstance(layer, Marks):
            parts.append(mark(layer.shape, at + 3.0, 8.5, 2.8, layer.class_))
        elif isinstance(layer, Polyline):
            at -= 8.0
            parts.append(segment(at, 8.5, at + 13.0, 8.5, f"line {layer.class_}"))
        else:
            at -= 4.0
            class_ = "ribbon" if isinstance(layer, Ribbon) else "band"
            parts.append(element("rect", x=at, y=4.5, width=10.0, height=8.0, class_=class_))
        at -= 9.0
    return join(parts)


def drawn(picture: Picture) -> Html:
    """Draw a picture under its caption."""
    return figure(picture.title, plot(picture))

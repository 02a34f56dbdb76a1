"""Pictures as inline SVG: frame, ticks, bands, lines and marks.

Plots are drawn for the width of a phone and enlarged on larger screens. Colours and line styles are classes of the
page's style sheet, so that they follow its theme; marks differ in shape as well.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from operator_app.report.html.markup import Html, element, join
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
LEFT, RIGHT, TOP, BELOW = 46.0, 352.0, 22.0, 34.0
"""Left, right and upper edge of the frame of a plot, and the height below the frame, in the units of the picture."""
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
    """Draw a picture as a complete SVG image, with a title and a description for screen readers."""
    drawn = draw(of)
    return element(
        "svg",
        element("title", of.title, id=f"{of.ident}-t"),
        element("desc", of.description, id=f"{of.ident}-d"),
        *drawn.parts,
        viewBox=f"0 0 {PLOT_WIDTH:g} {drawn.height:g}",
        role="img",
        aria_labelledby=f"{of.ident}-t {of.ident}-d",
        class_="plot",
    )


def draw(of: Picture) -> Drawn:
    """Draw the layers of a picture in one frame, later ones on top."""
    height = HEIGHT if of.aspect == 0.0 else (RIGHT - LEFT) / of.aspect + TOP + BELOW
    frame = _Frame(of.x, of.y, height - BELOW)
    marks = max((len(layer.x) for layer in of.layers if isinstance(layer, Marks)), default=0)
    radius = 2.6 if marks <= 60 else 2.0 if marks <= 150 else 1.4
    parts = [
        *frame.grid(),
        *(part for layer in of.layers for part in frame.layer(layer, radius)),
        _legend(of.layers),
        label(of.y.title, 2.0, 12.0, class_="axis"),
        label(of.x.title, RIGHT, height - 3.0, class_="axis", anchor="end"),
    ]
    return Drawn(height, tuple(parts))


@dataclass(frozen=True, slots=True)
class _Frame:
    x: Axis
    y: Axis
    bottom: float

    def across(self, value: float) -> float:
        return self.x.place(value, LEFT, RIGHT)

    def up(self, value: float) -> float:
        return self.y.place(value, self.bottom, TOP)

    def points(self, places: Iterable[tuple[float, float]]) -> str:
        return " ".join(f"{self.across(a):.1f},{self.up(b):.1f}" for a, b in places)

    def grid(self) -> Iterator[Html]:
        for value, tick_text in zip(self.y.ticks, self.y.tick_texts, strict=True):
            at = self.up(value)
            yield segment(LEFT, at, RIGHT, at, "zero" if value == 0.0 else "grid")
            yield label(tick_text, LEFT - 5.0, at + 3.6, anchor="end")
        yield segment(LEFT, self.bottom, RIGHT, self.bottom, "frame")
        yield from ticks(self.x, LEFT, RIGHT, self.bottom)

    def layer(self, layer: Layer, radius: float) -> Iterator[Html]:
        """Yield the elements of a layer; `radius`: radius of the marks of a layer without `sizes`."""
        match layer:
            case Band():
                top = self.up(min(layer.high, self.y.high))
                height = max(0.0, self.up(max(layer.low, self.y.low)) - top)
                yield rectangle(LEFT, top, RIGHT - LEFT, height, "band")
            case Ribbon():
                high = zip(layer.x, layer.high, strict=True)
                low = reversed([*zip(layer.x, layer.low, strict=True)])
                yield element("polygon", points=self.points(chain(high, low)), class_="ribbon")
            case Polyline():
                points = self.points(zip(layer.x, layer.y, strict=True))
                yield element("polyline", points=points, class_=f"line {layer.class_}")
            case Marks():
                for k, (a, b) in enumerate(zip(layer.x, layer.y, strict=True)):
                    if math.isfinite(a) and math.isfinite(b):
                        tip = layer.tips[k] if layer.tips else ""
                        size = LARGEST_MARK * math.sqrt(layer.sizes[k]) if layer.sizes else radius
                        yield mark(layer.shape, self.across(a), self.up(b), size, layer.class_, tip)


def ticks(x: Axis, left: float, right: float, foot: float) -> Iterator[Html]:
    """Yield the ticks of a horizontal axis at the foot of a drawing, with their numbers."""
    for value, tick_text in zip(x.ticks, x.tick_texts, strict=True):
        at = x.place(value, left, right)
        yield segment(at, foot, at, foot + 3.5, "frame")
        yield label(tick_text, at, foot + 14.0, anchor="middle")


def mark(shape: Shape, x: float, y: float, r: float, class_: str, tip: str = "") -> Html:
    """Draw one mark; if `tip` is not empty, the mark has this tooltip."""
    inside = [element("title", tip)] if tip else []
    name = f"mark {class_}"
    match shape:
        case "dot":
            return element("circle", *inside, cx=x, cy=y, r=r, class_=name)
        case "square":
            s = 0.88 * r
            return rectangle(x - s, y - s, 2.0 * s, 2.0 * s, name, *inside)
        case "triangle":
            s = 1.25 * r
            path = f"M{x:.1f} {y - s:.1f}l{s:.1f} {1.8 * s:.1f}h{-2.0 * s:.1f}z"
            return element("path", *inside, d=path, class_=name)


def rectangle(x: float, y: float, width: float, height: float, class_: str, *inside: Html) -> Html:
    """Draw a rectangle with its upper left corner at (x, y); `inside`: child elements, such as a tooltip."""
    return element("rect", *inside, x=x, y=y, width=width, height=height, class_=class_)


def label(
    text: str, x: float, y: float, *, class_: str = "tick", anchor: str | None = None
) -> Html:
    """Return text at a point of a picture."""
    return element("text", typeset(text), x=x, y=y, class_=class_, text_anchor=anchor)


def segment(x1: float, y1: float, x2: float, y2: float, class_: str) -> Html:
    """Draw a straight line."""
    return element("line", x1=x1, y1=y1, x2=x2, y2=y2, class_=class_)


def _legend(layers: Sequence[Layer]) -> Html:
    parts: list[Html] = []
    at = RIGHT
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
            parts.append(rectangle(at, 4.5, 10.0, 8.0, class_))
        at -= 9.0
    return join(parts)


def drawn(picture: Picture) -> Html:
    """Draw a picture under its caption."""
    return element("figure", element("figcaption", element("b", picture.title)), plot(picture))

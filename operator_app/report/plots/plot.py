"""The content of a plot: axes, bands, lines and marks. Values are in the units of their axes."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from operator_app.units import fixed, significant

Shape = Literal["dot", "square", "triangle"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """A linear axis from `low` to `high` with `ticks` at round numbers."""

    label: str
    unit: str
    low: float
    high: float
    ticks: tuple[float, ...]

    def place(self, value: float, start: float, end: float) -> float:
        """Return the coordinate of `value` on the drawn axis, where `low` is at `start` and `high` at `end`."""
        return start + (value - self.low) / (self.high - self.low) * (end - start)

    @property
    def title(self) -> str:
        """Label with unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    @property
    def tick_texts(self) -> tuple[str, ...]:
        """Ticks as text, all with the same number of decimal places or significant digits."""
        step = self.ticks[1] - self.ticks[0] if len(self.ticks) > 1 else 1.0
        largest = max(abs(t) for t in self.ticks)
        if largest >= 1e5 or step < 1e-4:
            # Enough digits to distinguish neighbouring ticks.
            digits = math.floor(math.log10(largest)) - math.floor(math.log10(step) + 1e-9) + 1
            return tuple(significant(t, max(2, digits)) for t in self.ticks)
        places = max(0, -math.floor(math.log10(step) + 1e-9))
        return tuple(fixed(t, places) for t in self.ticks)


def axis(
    label: str,
    values: Iterable[float],
    *,
    unit: str = "",
    whole: bool = False,
    symmetric: bool = False,
) -> Axis:
    """Return an axis that contains all finite `values`, with a small margin and about five ticks.

    `whole`: ticks only at whole numbers. `symmetric`: zero in the middle.
    """
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
    ticks = _ticks(low, high, _round_step((high - low) / 5, whole=whole))
    return Axis(label=label, unit=unit, low=low, high=high, ticks=ticks)


def _ticks(low: float, high: float, step: float) -> tuple[float, ...]:
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return tuple(k * step + 0.0 for k in range(first, last + 1))


def map_axes(
    labels: tuple[str, str], x: Iterable[float], y: Iterable[float], *, unit: str, aspect: float
) -> tuple[Axis, Axis]:
    """Return two axes of equal scale that contain all values, in a frame whose width is `aspect` times its height."""
    across, up = axis(labels[0], x, unit=unit), axis(labels[1], y, unit=unit)
    width, height = across.high - across.low, up.high - up.low
    size = max(width, aspect * height)
    step = _round_step(size / 6.0, whole=False)
    return _about(across, size, step), _about(up, size / aspect, step)


def _about(axis: Axis, size: float, step: float) -> Axis:
    """Return an axis of length `size` with the same middle as `axis`, and a tick at every `step`."""
    middle = 0.5 * (axis.low + axis.high)
    low, high = middle - 0.5 * size, middle + 0.5 * size
    return replace(axis, low=low, high=high, ticks=_ticks(low, high, step))


@dataclass(frozen=True, slots=True, kw_only=True)
class LogAxis(Axis):
    """A logarithmic axis; ticks are at powers of ten and, if these are few, at 2 and 5 times powers of ten."""

    def place(self, value: float, start: float, end: float) -> float:
        """Return the coordinate of a positive `value`, as `Axis.place` does, but on a logarithmic scale."""
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return start + share * (end - start)

    @property
    def tick_texts(self) -> tuple[str, ...]:
        """Ticks as text, each with as many digits as necessary."""
        return tuple(f"{t:,.0f}" if t >= 1.0 else f"{t:g}" for t in self.ticks)


def log_axis(label: str, values: Iterable[float], *, unit: str = "") -> LogAxis:
    """Return a logarithmic axis that contains all finite positive `values`, with a small margin."""
    positive = [v for v in values if math.isfinite(v) and v > 0.0] or [1.0]
    low, high = min(positive) / 1.2, max(positive) * 1.2
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1.0, 2.0, 5.0) if len(decades) <= 4 else (1.0,)
    ticks = tuple(m * 10.0**k for k in decades for m in steps if low <= m * 10.0**k <= high)
    return LogAxis(label=label, unit=unit, low=low, high=high, ticks=ticks)


def _round_step(least: float, *, whole: bool) -> float:
    """Return 1, 2 or 5 times a power of ten, the smallest that is not below `least`; if `whole`, at least 1."""
    if whole and least <= 1.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(least))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if least <= m * power * (1.0 + 1e-9))


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """Shaded strip between two values of y."""

    low: float
    high: float
    label: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ribbon:
    """Shaded band between two curves over the same x, such as the uncertainty of a curve."""

    x: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]
    label: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Polyline:
    """Points joined by a line. `class_` is a colour, ``a`` or ``b``, or ``dashed``, or ``gap`` for a closure error."""

    x: Sequence[float]
    y: Sequence[float]
    class_: str = "a"
    label: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """Points. `class_` is a colour, ``a`` to ``d``; `tips` has a description of each point.

    `sizes`: areas of the marks relative to the largest possible area; empty: all marks have the usual area.
    """

    x: Sequence[float]
    y: Sequence[float]
    shape: Shape = "dot"
    class_: str = "a"
    label: str = ""
    tips: Sequence[str] = ()
    sizes: Sequence[float] = ()


Layer = Band | Ribbon | Polyline | Marks


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A plot: name, title, description, axes, and layers, of which the first is drawn lowest.

    `aspect`: width of the frame divided by its height; 0 lets the renderer choose.
    """

    ident: str
    title: str
    description: str
    x: Axis
    y: Axis
    layers: Sequence[Layer]
    aspect: float = 0.0

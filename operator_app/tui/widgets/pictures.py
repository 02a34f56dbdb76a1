"""Pictures drawn with braille characters: plots, and the arm with its next pose; also rows of bars."""

import math
from collections.abc import Sequence
from itertools import pairwise
from operator import is_not

import numpy as np

from hardware.arm import JointMode
from operator_app.report.plots.braille import Canvas
from operator_app.report.plots.plot import Axis, Band, Marks, Picture, Polyline, Ribbon
from operator_app.report.spans import Line, Span, line, wrapped
from operator_app.session.ui.snapshot import DataState, SessionSnapshot
from operator_app.tui.lines import Lines
from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.loops.closure import ClosureModel

LABEL = 9
"""Width in cells of the vertical axis and its numbers."""
SERIES_ROLES = {"a": "text", "b": "accent", "c": "warn", "d": "dim"}
"""Colour roles of lines and marks, by the class of a plot's layer (`class_`)."""


def plot(of: Picture, width: int, height: int, *, ascii_only: bool) -> list[Line]:
    """Return the plot `of` as `height` lines of `width` cells; empty if it does not fit."""
    if width < LABEL + 10 or height < 6:
        return []
    x, y = of.x, of.y
    canvas = Canvas(width - LABEL - 1, height - 3, ascii_only=ascii_only)
    left_edge, right, top, bottom = 1.0, canvas.width - 3.0, 0.0, canvas.height - 1.0
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
            (x.place(a, left_edge, right), y.place(b, bottom, top))
            for a, b in zip(layer.x, layer.y, strict=True)
            if math.isfinite(a) and math.isfinite(b)
        ]
        if isinstance(layer, Polyline):
            for one, other in pairwise(places):
                canvas.segment(*one, *other, SERIES_ROLES.get(layer.class_, "text"))
        if isinstance(layer, Marks):
            for place in places:
                canvas.blob(*place, SERIES_ROLES[layer.class_])
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
    labels: dict[int, str] = {}
    for value, text in zip(y.ticks, y.tick_texts, strict=True):
        row = canvas.row(y.place(value, bottom, top))
        if not {row - 1, row, row + 1} & labels.keys():
            labels[row] = text
    return labels


def _below(x: Axis, width: int) -> str:
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
LARGEST_BAR_RATIO = 30.0
"""Largest ratio of values on the scale, limited so that one bad first value does not flatten the rest."""


def sparkline(values: Sequence[float], width: int) -> Span:
    """Return a row of bars, log scale, for `values`, oldest first. At most `width` values, evenly spaced, are shown."""
    last, cells = len(values) - 1, max(1, min(width, len(values)))
    sampled = [values[round(k * last / max(1, cells - 1))] for k in range(cells)]
    finite = [v for v in sampled if math.isfinite(v) and v > 0.0] or [1.0]
    low = min(finite)
    decades = math.log10(min(max(finite) / low, LARGEST_BAR_RATIO))
    shares = [
        min(1.0, math.log10(max(v / low, 1.0)) / decades) if math.isfinite(v) else 1.0
        for v in sampled
    ] if decades > 0.0 else [0.0] * cells  # fmt: skip
    return ("".join(SPARKS[int(share * 7.99)] for share in shares), "dim")


_TURN, _TILT = np.deg2rad(35.0), np.deg2rad(18.0)
_VIEW = np.array(
    [
        [0.0, np.cos(_TURN), np.sin(_TURN)],
        [np.cos(_TILT), -np.sin(_TILT) * np.sin(_TURN), np.sin(_TILT) * np.cos(_TURN)],
    ]
)
"""The screen's right and up as directions (2, 3) in the base frame, whose x axis points up."""
_AXIS_M = 0.16
"""Half the length of the drawn hinge axis."""
VISIBLE_RAD = 0.015
"""Smallest rotation that is redrawn, rad: a smaller one moves the drawing by less than a dot, and may be RVDT noise."""


class ArmView(Lines):
    """Drawing of the arm at its current pose. Scale and centre change only with the predicted poses."""

    TITLE = "Arm"

    _box: FloatArray | None = None
    _box_of: object = None
    _figures: tuple[object, ...] = ()
    _things: tuple[object, ...] = ()
    _at: FloatArray = np.zeros(0)
    _next: tuple[FloatArray, ...] = ()
    _drawn: Sequence[Line] = ()
    _turn = False

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        if s.arm is None or s.data is DataState.LOST:
            self.set_title("Arm")
            if s.arm is None:
                return [(), line((" no arm connected", "dim"))]
            return [(), *wrapped(" ▲ data LOST: the arm is not drawn", width, "warn", "   ")]
        q = s.arm.positions_rad
        x = s.live.x if s.live is not None and s.live.estimated else None
        modes = tuple(j.mode for j in s.arm.joints)
        figures = (s.next_waypoint, s.chooses_by_plan, modes, width, height)
        things = (s.procedure, x, s.forecast, s.heading)
        news = figures != self._figures or any(map(is_not, things, self._things))
        self._turn = not self._turn
        # Motion is redrawn at most ten times a second, because this panel takes the most time.
        if news or (self._turn and np.abs(q - self._at).max() > VISIBLE_RAD):
            self._drawn = self._draw(s, q, x, width, height, redraw=news)
            self._figures, self._things, self._at = figures, things, q
        self.set_title("Arm (dotted: next pose)" if any(map(len, self._next)) else "Arm")
        return self._drawn

    def _draw(
        self,
        s: SessionSnapshot,
        q: FloatArray,
        x: FloatArray | None,
        width: int,
        height: int,
        *,
        redraw: bool,
    ) -> Sequence[Line]:
        model = s.procedure.fixture.fixture.model(s.procedure.arm)
        x = nominal_vector(model.parameters) if x is None else x
        drawn = model.drawn(x, q)
        if drawn is None:
            return [line((" this fixture has no drawing", "dim"))]
        canvas = Canvas(width, height - 1, ascii_only=self.look.ascii_only)
        chain, axis = drawn
        if self._box is None or self._box_of is not s.forecast:
            self._box, self._box_of = _box(model, x, q, s), s.forecast
        place = _Placing(self._box, canvas)
        if redraw:
            self._next = _next_lines(model, x, s)
        for path, every in zip(self._next, (4, 2), strict=False):
            place.path(path, role="dim", every=every)
        ends = np.stack((chain[-1] - _AXIS_M * axis, chain[-1] + _AXIS_M * axis))
        place.path(ends, role="dim", every=2)
        place.path(chain, role="text", every=1, thick=True)
        place.letter(chain[0], "B", "bold")
        for joint, mode in enumerate((j.mode for j in s.arm.joints) if s.arm else (), 1):
            if joint in (2, 4, 6) or mode is JointMode.POSITION:
                role = "accent" if mode is JointMode.POSITION else "bold"
                place.letter(chain[joint - 1], str(joint), role)
        place.letter(chain[-1], "⊕", "bold")
        return [*canvas.lines(), line((" B base, ⊕ tool, 1-7 joints", "dim"))]


def _next_lines(model: ClosureModel, x: FloatArray, s: SessionSnapshot) -> tuple[FloatArray, ...]:
    """Return the arm at the next pose and, during a planned move, the tool's path; () if there is no next pose.

    Each is a line through k points (k, 3) in the arm's base frame, m. `x`: parameters of `model`, rad or m.
    """
    if s.heading is not None:
        way = s.heading.trace_rad
        if way is None:
            return ()
        sampled = way[:: max(1, len(way) // 12)]
        return _points(model, x, way[-1]), np.stack([_points(model, x, q)[-1] for q in sampled])
    if s.forecast is None or s.next_waypoint is None or s.chooses_by_plan:
        return ()
    return (_points(model, x, s.forecast.q_rad[s.next_waypoint]),)


def _points(model: ClosureModel, x: FloatArray, q: FloatArray) -> FloatArray:
    drawn = model.drawn(x, q)
    return np.empty((0, 3)) if drawn is None else drawn[0]


def _box(model: ClosureModel, x: FloatArray, q: FloatArray, s: SessionSnapshot) -> FloatArray:
    """Return the lower left and the upper right corner (2, 2), m, of the area in which the arm is drawn.

    The whole arm fits in at the joint angles `q` and at planned poses. `x`: parameters of `model`, rad or m.
    """
    poses = [q] if s.forecast is None else [q, *s.forecast.q_rad[s.forecast.reachable][:40]]
    points = np.concatenate([_points(model, x, pose) for pose in poses]) @ _VIEW.T
    low, high = points.min(axis=0), points.max(axis=0)
    return np.stack((low - 0.08, high + 0.08))


class _Placing:
    def __init__(self, box: FloatArray, canvas: Canvas) -> None:
        self._canvas = canvas
        size = box[1] - box[0]
        self._scale = min((canvas.width - 2) / size[0], (canvas.height - 2) / size[1])
        self._middle = box.mean(axis=0)

    def _dots(self, points: FloatArray) -> FloatArray:
        flat = (points @ _VIEW.T - self._middle) * self._scale
        return np.stack(
            (self._canvas.width / 2 + flat[..., 0], self._canvas.height / 2 - flat[..., 1]), axis=-1
        )

    def path(self, points: FloatArray, *, role: str, every: int, thick: bool = False) -> None:
        dots = self._dots(points)
        for (x0, y0), (x1, y1) in pairwise(dots):
            self._canvas.segment(x0, y0, x1, y1, role, every)
            if thick:
                self._canvas.segment(x0 + 1, y0, x1 + 1, y1, role, every)

    def letter(self, point: FloatArray, text: str, role: str) -> None:
        x, y = self._dots(point)
        self._canvas.letter(x, y, text, role)

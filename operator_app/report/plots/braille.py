"""A canvas of braille dots (2 x 4 per cell) or ASCII marks, and drawings of a plan on it."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from textwrap import wrap

import numpy as np

from operator_app.planning.preview import PlannedPose, Preview
from operator_app.report.spans import Line
from operator_app.units import SPAN, WHOLE_DEGREES, names
from solver.arrays import FloatArray

_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
_LAST_BITS = 1e-6
"""Added to a position before it is rounded down, so that floating-point errors do not change the dot."""
_ASCII_MARK = {"text": "*", "dim": ".", "accent": "o", "warn": "!", "alarm": "!"}


class Canvas:
    """Dots and letters on a grid of cells; the origin is at the top left, y goes down.

    `ascii_only`: one ASCII mark per cell instead of braille dots.
    """

    def __init__(self, columns: int, rows: int, *, ascii_only: bool) -> None:
        self.columns, self.rows = max(columns, 0), max(rows, 0)
        self._ascii = ascii_only
        self._bits = [[0] * self.columns for _ in range(self.rows)]
        self._roles = [["text"] * self.columns for _ in range(self.rows)]
        self._letters: dict[tuple[int, int], tuple[str, str]] = {}

    @property
    def width(self) -> int:
        """Width in dots."""
        return 2 * self.columns

    @property
    def height(self) -> int:
        """Height in dots."""
        return 4 * self.rows

    @staticmethod
    def row(y: float) -> int:
        """Return the row of cells that contains a dot at `y`."""
        return _whole(y) // 4

    def dot(self, x: float, y: float, role: str = "text") -> None:
        """Set one dot; a dot outside the canvas is ignored."""
        across, down = _whole(x), _whole(y)
        column, row = across // 2, self.row(y)
        if 0 <= column < self.columns and 0 <= row < self.rows:
            self._bits[row][column] |= _DOTS[across % 2][down % 4]
            self._roles[row][column] = role

    def segment(
        self, x0: float, y0: float, x1: float, y1: float, role: str = "text", every: int = 1
    ) -> None:
        """Draw a straight line. If `every` is above 1, only every second, third, ... dot is set: the line is dotted."""
        steps = _whole(max(abs(x1 - x0), abs(y1 - y0), 1.0))
        for k in range(0, steps + 1, every):
            self.dot(x0 + (x1 - x0) * k / steps, y0 + (y1 - y0) * k / steps, role)

    def blob(self, x: float, y: float, role: str = "text") -> None:
        """Set a square of 2 x 2 dots."""
        for dx, dy in product((0, 1), repeat=2):
            self.dot(x + dx, y + dy, role)

    def letter(self, x: float, y: float, text: str, role: str = "text") -> None:
        """Write text into cells, starting at the cell that contains the dot (x, y)."""
        column, row = _whole(x) // 2, self.row(y)
        for k, character in enumerate(text):
            if 0 <= column + k < self.columns and 0 <= row < self.rows:
                self._letters[row, column + k] = (character, role)

    def lines(self) -> Sequence[Line]:
        """Return the picture as lines of spans."""
        out: list[Line] = []
        for row in range(self.rows):
            spans: list[tuple[str, str]] = []
            for column in range(self.columns):
                text, role = self._cell(row, column)
                if spans and (spans[-1][1] == role or text == " "):
                    spans[-1] = (spans[-1][0] + text, spans[-1][1])
                else:
                    spans.append((text, role))
            out.append(tuple(spans))
        return out

    def _cell(self, row: int, column: int) -> tuple[str, str]:
        if letter := self._letters.get((row, column)):
            return letter
        bits, role = self._bits[row][column], self._roles[row][column]
        if not bits:
            return " ", role
        if self._ascii:
            return _ASCII_MARK.get(role, "*"), role
        return chr(0x2800 + bits), role


def _whole(place: float) -> int:
    return math.floor(place + _LAST_BITS)


COLUMNS, BAR_ROWS = 66, 16
"""Width and height of the drawing in cells, without its scales."""
BAR_CELLS = 46
SCALE_CELLS = 9
"""Width of the scale at the left, in cells."""
NEIGHBOURS = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1), (0, 2))
"""Places for a label in the order of preference, as shifts by (rows down, label widths to the right): the first that is
not occupied is used."""


def region_lines(shown: Preview, *, ascii_only: bool) -> list[str]:
    """Draw the reachable region, the poses in visiting order and the path between them."""
    across, up = _axes(shown)
    plane = _Plane(shown, across, up, ascii_only=ascii_only)
    plane.region()
    for pose in shown.poses:
        plane.way(pose)
    plane.mark(shown.plan.manifold.q[0], "S")
    omitted = [n for n, pose in enumerate(shown.poses, 1) if not plane.mark(pose.q_rad, str(n))]
    text = f"Poses not numbered, for lack of room: {names(omitted)}." if omitted else ""
    return [*plane.lines(), *wrap(text, COLUMNS, initial_indent="  ", subsequent_indent="  ")]


def coverage_lines(shown: Preview, *, ascii_only: bool) -> list[str]:
    """Draw the range of every joint, its reachable part, and the poses."""
    empty, reachable, taken, left_end, right = " -#||" if ascii_only else " ─█├┤"
    reach = shown.plan.reach_rad
    lines = []
    for k, joint in enumerate(shown.arm.joints):
        angles = np.array([*reach[k], *(pose.q_rad[k] for pose in shown.poses)])
        share = (angles - joint.lower_rad) / (joint.upper_rad - joint.lower_rad)
        cells = np.clip(share * BAR_CELLS, 0.0, BAR_CELLS - 1.0).astype(int).tolist()
        first, last, *of_poses = cells
        bar = [empty] * BAR_CELLS
        bar[first : last + 1] = [reachable] * (last + 1 - first)
        for cell in of_poses:
            bar[cell] = taken
        low, high = (SPAN(v).shown for v in (joint.lower_rad, joint.upper_rad))
        lines.append(f"  J{k + 1} {low:>8} {left_end}{''.join(bar)}{right} {high:>7}")
    return lines


class _Plane:
    """A plot of two joints' angles on a canvas; `across`, `up`: joints (from 0) of the horizontal and vertical axis."""

    def __init__(self, shown: Preview, across: int, up: int, *, ascii_only: bool) -> None:
        self._canvas = Canvas(COLUMNS, BAR_ROWS, ascii_only=ascii_only)
        self._shown, self._axes = shown, (across, up)
        self._labelled: set[tuple[int, int]] = set()
        self._left, self._bottom = ("|", "-") if ascii_only else ("│", "─")
        reach = shown.plan.manifold.q[:, [across, up]]
        low, high = reach.min(axis=0), reach.max(axis=0)
        room = 0.04 * (high - low) + 1e-9
        self._low, self._size = low - room, high - low + 2.0 * room

    def region(self) -> None:
        """Draw the reachable region: one dot in every character cell that contains a reachable pose."""
        for q in self._shown.plan.manifold.q[self._shown.plan.allowed]:
            x, y = self._at(q)
            self._canvas.dot(2 * (int(x) // 2), 4 * (int(y) // 4) + 1, "dim")

    def way(self, pose: PlannedPose) -> None:
        for leg in pose.route or ():
            for start, end in pairwise(map(self._at, leg.trace_rad)):
                self._canvas.segment(*start, *end)

    def mark(self, q_rad: FloatArray, text: str) -> bool:
        """Write a label at a pose, or beside it if there is already a label; false if there is no room for it."""
        x, y = self._at(q_rad)
        column, row = int(x) // 2, int(y) // 4
        # Prefer places that touch no other label: 6 beside 7 would read as 67.
        for gap, (down, right) in product((1, 0), NEIGHBOURS):
            cells = [(row + down, column + right * len(text) + k) for k in range(len(text))]
            inside = all(0 <= r < BAR_ROWS and 0 <= c < COLUMNS for r, c in cells)
            around = {(r, c + k) for r, c in cells for k in range(-gap, gap + 1)}
            if inside and not self._labelled & around:
                self._labelled.update(cells)
                self._canvas.letter(2.0 * cells[0][1], 4.0 * cells[0][0], text)
                return True
        return False

    def lines(self) -> Iterator[str]:
        across, up = self._axes
        low, high = self._low, self._low + self._size
        unit = WHOLE_DEGREES.quantity.unit
        rows = ["".join(text for text, _ in spans) for spans in self._canvas.lines()]
        yield f"  J{up + 1} {unit}"
        for k, row in enumerate(rows):
            share = (k + 0.5) / len(rows)
            scale = WHOLE_DEGREES(high[1] - share * (high[1] - low[1])).shown if k % 5 == 0 else ""
            yield f"{scale:>{SCALE_CELLS - 2}} {self._left}{row}".rstrip()
        yield " " * (SCALE_CELLS - 1) + self._left + self._bottom * COLUMNS
        first, last = (WHOLE_DEGREES(v[0]).shown for v in (low, high))
        name = f"J{across + 1} {unit}".center(COLUMNS - 16)
        yield f"{' ' * SCALE_CELLS}{first:<8}{name}{last:>8}"

    def _at(self, q_rad: FloatArray) -> tuple[float, float]:
        across, up = self._axes
        share = (np.array([q_rad[across], q_rad[up]]) - self._low) / self._size
        return (
            float(share[0]) * (self._canvas.width - 1),
            (1.0 - float(share[1])) * (self._canvas.height - 1),
        )


def _axes(shown: Preview) -> tuple[int, int]:
    """Return the joints (from 0) on the axes: the first two drives, or the only drive and the joint that moves most."""
    drives = [j - 1 for j in shown.choice.drives]
    if len(drives) > 1:
        return drives[0], drives[1]
    span = np.ptp(shown.plan.manifold.q[shown.plan.allowed], axis=0)
    span[drives[0]] = -1.0
    return drives[0], int(np.argmax(span))

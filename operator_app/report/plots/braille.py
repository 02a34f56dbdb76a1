"""A canvas of braille dots, 2 x 4 to a cell, or of ASCII marks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # `sarcal plan` draws with this and does without Textual.
    from operator_app.report.spans import Line

_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
_LAST_BITS = 1e-6
"""Positions that differ by rounding errors only fall on the same dot on every machine."""
_ASCII_MARK = {"text": "*", "dim": ".", "accent": "o", "warn": "!", "alarm": "!"}


class Canvas:
    """Dots and letters on a grid of cells; the origin is at the top left, y goes down.

    Parameters
    ----------
    columns, rows
        Size in cells.
    ascii_only
        One mark a cell instead of braille.
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
        """Row of cells in which a dot at this height lies."""
        return _whole(y) // 4

    def dot(self, x: float, y: float, role: str = "text") -> None:
        """Set one dot; outside the canvas it is ignored."""
        across, down = _whole(x), _whole(y)
        column, row = across // 2, self.row(y)
        if 0 <= column < self.columns and 0 <= row < self.rows:
            self._bits[row][column] |= _DOTS[across % 2][down % 4]
            self._roles[row][column] = role

    def segment(
        self, x0: float, y0: float, x1: float, y1: float, role: str = "text", every: int = 1
    ) -> None:
        """Draw a straight line; `every` > 1 leaves gaps."""
        steps = _whole(max(abs(x1 - x0), abs(y1 - y0), 1.0))
        for k in range(0, steps + 1, every):
            self.dot(x0 + (x1 - x0) * k / steps, y0 + (y1 - y0) * k / steps, role)

    def blob(self, x: float, y: float, role: str = "text") -> None:
        """Set a square of 2 x 2 dots."""
        for dx in (0, 1):
            for dy in (0, 1):
                self.dot(x + dx, y + dy, role)

    def letter(self, x: float, y: float, text: str, role: str = "text") -> None:
        """Write text over the cell at a dot."""
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
        letter = self._letters.get((row, column))
        if letter is not None:
            return letter
        bits, role = self._bits[row][column], self._roles[row][column]
        if not bits:
            return " ", role
        if self._ascii:
            return _ASCII_MARK.get(role, "*"), role
        return chr(0x2800 + bits), role


def _whole(place: float) -> int:
    return math.floor(place + _LAST_BITS)

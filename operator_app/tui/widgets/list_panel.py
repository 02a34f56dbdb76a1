"""A list below a header that may be longer than its panel: the arrows mark a row or scroll."""

from __future__ import annotations

from collections.abc import Sequence

from operator_app.report.spans import Line, window
from operator_app.report.table import FactTable
from operator_app.report.terminal import table_spans
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.tui.lines import Lines


class ListPanel(Lines):
    """Subclasses override `head`, `count` and `row`.

    With `MARKS`, `cursor` is the marked row and stays in view; without, it is the first one shown.
    """

    MARKS = True

    def __init__(self, *, id: str | None = None) -> None:  # noqa: A002 - Textual's name
        super().__init__(id=id, classes="panel")
        self.cursor = 0
        self._last = 0

    def head(self, s: SessionSnapshot, width: int) -> Sequence[Line]:
        """Lines that stay on top."""
        return ()

    def count(self, s: SessionSnapshot) -> int:
        """How many rows there are."""
        return 0

    def row(self, s: SessionSnapshot, k: int, width: int) -> Sequence[Line]:
        """Lines of row `k`, from 0."""
        return ()

    def move(self, by: int) -> None:
        """Move the mark, or scroll."""
        self.cursor = max(0, min(self._last, self.cursor + by))

    def build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        """Header and what fits of the rows."""
        head, count = self.head(s, width), self.count(s)
        room = max(1, height - len(head))
        if self.MARKS:
            self._last = max(0, count - 1)
            self.cursor = min(self.cursor, self._last)
            first = max(0, min(self.cursor - room // 2, count - room))
            some = range(first, min(count, first + room))
            return [*head, *(line for k in some for line in self.row(s, k, width))]
        rows = [line for k in range(count) for line in self.row(s, k, width)]
        rows, shown, self.cursor = window(rows, self.cursor, room)
        self._last = count - shown
        return [*head, *rows]


class TablePanel(ListPanel):
    """A table of facts: subclasses say which."""

    MARKS = False

    def table(self, s: SessionSnapshot) -> FactTable | None:
        """Return what is shown; None: nothing."""
        return None

    def build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        """Head, and what fits of the rows."""
        table = self.table(s)
        self._head, self._rows = ([], []) if table is None else table_spans(table)
        return super().build(s, width, height)

    def count(self, s: SessionSnapshot) -> int:
        """Rows."""
        return len(self._rows)

    def head(self, s: SessionSnapshot, width: int) -> Sequence[Line]:
        """Titles."""
        return self._head

    def row(self, s: SessionSnapshot, k: int, width: int) -> Sequence[Line]:
        """One row."""
        return [self._rows[k]]

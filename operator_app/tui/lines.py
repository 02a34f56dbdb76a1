"""A widget that shows lines of plain spans and repaints only those that changed. Knows no content.

No markup anywhere: brackets in `[deg]` are brackets. A span is text and the name of its role.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.segment import Segment
from rich.style import Style
from textual.content import Content
from textual.geometry import Region
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

if TYPE_CHECKING:
    from operator_app.session.snapshot import SessionSnapshot
    from operator_app.tui.look import Look

Span = tuple[str, str]
Line = tuple[Span, ...]


def line(*parts: str | Span) -> Line:
    """Make a line; bare strings are in the ``text`` role."""
    return tuple((p, "text") if isinstance(p, str) else p for p in parts)


def length(of: Line) -> int:
    """Cells a line takes; every character used here is one cell wide."""
    return sum(len(text) for text, _ in of)


def clip(of: Line, width: int) -> Line:
    """Cut a line to a width, with an ellipsis where something is lost."""
    if length(of) <= width:
        return of
    out: list[Span] = []
    left = width - 1
    for text, role in of:
        if left <= 0:
            break
        out.append((text[:left], role))
        left -= len(text[:left])
    return (*out, ("…", "dim")) if width > 0 else ()


def wrapped(text: str, width: int, role: str = "text", indent: str = "") -> list[Line]:
    """Wrap a sentence; continuation lines are indented."""
    rows = textwrap.wrap(text, max(width, 8), subsequent_indent=indent, break_long_words=True)
    return [((row, role),) for row in rows] or [()]


def beside(left: Line, right: Line, width: int) -> Line:
    """Put one line at the left and one at the right end."""
    gap = max(1, width - length(left) - length(right))
    return (*left, (" " * gap, "text"), *right)


class Clicked(Message):
    """The operator clicked an action by name."""

    def __init__(self, action: str) -> None:
        super().__init__()
        self.action = action


class Lines(Widget, can_focus=True):
    """Lines of spans.

    Subclasses override `build`, which turns a snapshot into lines for the size there is, and set
    `HELP`, the sentences that `?` shows while the panel is focused.
    """

    HELP = ""
    TITLE = ""

    def __init__(
        self,
        *,
        id: str | None = None,  # noqa: A002 - Textual's name
        classes: str | None = None,
    ) -> None:
        super().__init__(id=id, classes=classes)
        self._lines: tuple[Line, ...] = ()
        self._strips: dict[int, Strip] = {}
        self._base: Style | None = None

    def on_mount(self) -> None:
        """Title the frame."""
        self.retitle(self.TITLE)

    def retitle(self, text: str) -> None:
        """Set the title without reading markup in it."""
        app: Any = self.app
        new = Content(app.look.text(text)) if text else ""
        if str(self.border_title or "") != str(new):
            self.border_title = new

    def build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        """Return the lines for a snapshot."""
        return ()

    def show(self, s: SessionSnapshot) -> None:
        """Show a snapshot; only rows that differ are painted."""
        size = self.content_size
        if size.width and size.height:
            self.show_lines(self.build(s, size.width, size.height))

    def show_lines(self, lines: Sequence[Line]) -> None:
        """Show lines as they are."""
        new = tuple(tuple(row) for row in lines)
        old = self._lines
        changed = [
            y
            for y in range(max(len(new), len(old)))
            if y >= len(new) or y >= len(old) or new[y] != old[y]
        ]
        if not changed:
            return
        self._lines = new
        for y in changed:
            self._strips.pop(y, None)
        if len(changed) > 0.7 * max(1, self.content_size.height):
            self.refresh()
        else:
            width = self.content_size.width
            self.refresh(*(Region(0, y, width, 1) for y in changed))

    def forget(self) -> None:
        """Paint everything anew, after a change of look."""
        self._base = None
        self._strips.clear()
        self.refresh()

    def render_line(self, y: int) -> Strip:
        """Return one row."""
        strip = self._strips.get(y)
        if strip is None:
            width = self.content_size.width
            strip = self._strip(self._lines[y] if y < len(self._lines) else (), width)
            self._strips[y] = strip
        return strip

    def on_resize(self) -> None:
        """Forget rows that were cut for another width."""
        self._base = None
        self._strips.clear()

    def _strip(self, row: Line, width: int) -> Strip:
        app: Any = self.app
        look: Look = app.look
        row = clip(row, width)
        if self._base is None:
            self._base = self.rich_style
        base = self._base
        if row and row[0][1].startswith("cursor"):
            base += look.style("cursor")
        segments = [Segment(look.text(text), base + look.style(role)) for text, role in row]
        left = width - length(row)
        if left > 0:
            segments.append(Segment(" " * left, base))
        return Strip(segments, width)

"""A widget that shows lines of spans and repaints only changed lines. The text of a span contains no markup."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, cast

from rich.segment import Segment
from textual.content import Content
from textual.geometry import Region
from textual.strip import Strip
from textual.widget import Widget

from operator_app.report.spans import Line, clip, length
from operator_app.safe_output import sanitized

if TYPE_CHECKING:
    from textual.command import Provider
    from textual.message_pump import MessagePump

    from operator_app.session.ui.snapshot import SessionSnapshot
    from operator_app.tui.app import SarcalApp
    from operator_app.tui.theme import Look


def app_of(part: MessagePump | Provider) -> SarcalApp:
    """Return the app of a widget, a screen or a provider of commands."""
    return cast("SarcalApp", part.app)


class Lines(Widget, can_focus=True):
    """A widget with lines of spans.

    Subclasses override `_build`, which turns a snapshot into lines for the current size. `TITLE` is the panel's heading
    on the manual's page ``panels``, whose text `?` shows while the panel is focused.
    """

    TITLE = ""

    def __init__(self, *, id: str | None = None) -> None:  # noqa: A002 - Textual's name
        super().__init__(id=id)
        self.auto_links = False  # a mouse over a span that can be clicked changes nothing
        self.shown: tuple[Line, ...] = ()
        """Lines on the screen."""
        self._titled = ""

    @property
    def look(self) -> Look:
        """The app's `Look`: styles by role, and whether only ASCII is used."""
        return app_of(self).look

    def on_mount(self) -> None:
        """Set the title of the frame."""
        self.set_title(self.TITLE)

    def set_title(self, text: str) -> None:
        """Set the title of the frame to plain text, in which brackets are not markup."""
        new = self.look.text(text)
        # `border_title` cannot be compared: it returns markup, in which brackets are escaped.
        if new != self._titled:
            self._titled = new
            self.border_title = Content(new) if new else ""

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        return self.shown  # these lines do not depend on snapshots

    def show(self, s: SessionSnapshot) -> None:
        """Show a snapshot; only rows that have changed are painted."""
        if room := self.content_size:
            self.show_lines(self._build(s, room.width, room.height))

    def rows_of_all(self, s: SessionSnapshot) -> int:
        """Return the number of rows that the panel needs to show everything at its present width."""
        return len(self._build(s, self.content_size.width, sys.maxsize))

    def show_lines(self, lines: Sequence[Line]) -> None:
        """Show lines; only rows that have changed are painted."""
        new = tuple(tuple(row) for row in lines)
        rows = enumerate(zip_longest(self.shown, new))
        changed = [y for y, (old_row, new_row) in rows if old_row != new_row]
        if not changed:
            return
        self.shown = new
        if len(changed) > 0.7 * max(1, self.content_size.height):
            self.refresh()
        else:
            width = self.content_size.width
            self.refresh(*(Region(0, y, width, 1) for y in changed))

    def render_line(self, y: int) -> Strip:
        """Return row `y` of the lines shown, padded to the width of the widget."""
        look, width = self.look, self.content_size.width
        row = clip(self.shown[y], width) if y < len(self.shown) else ()
        base = self.visual_style.rich_style
        if row and row[0][1].startswith("cursor"):
            base += look.style("cursor")
        segments = [
            Segment(look.text(sanitized(text)), base + look.style(role)) for text, role in row
        ]
        return Strip(segments, length(row)).adjust_cell_length(width, base)

    def on_resize(self) -> None:
        """Build the rows for the new size."""
        if (picture := app_of(self).picture) is not None:
            self.show(picture)

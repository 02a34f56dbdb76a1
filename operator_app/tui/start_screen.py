"""The screen that is shown while the program loads; it imports little."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.screen import Screen

from operator_app.report.spans import Line, line
from operator_app.tui.lines import Lines


class _Fixed(Lines, can_focus=False):
    """A widget whose lines do not change."""

    FIXED = True

    def __init__(self, rows: list[Line], *, id: str) -> None:  # noqa: A002 - Textual's name
        super().__init__(id=id)
        self._rows = rows

    def on_mount(self) -> None:
        """Show them."""
        self.show_lines(self._rows)


class StartScreen(Screen[None]):
    """The strip, a line of text, and how to leave."""

    AUTO_FOCUS = ""

    def compose(self) -> ComposeResult:
        """Compose the widgets where the main screen has its own."""
        yield _Fixed(
            [line((" STOP ", "badge"), (" SPACE/F8", "key"), ("  no arm yet", "dim"))], id="strip"
        )
        yield _Fixed(
            [line((" sarcal ", "badge"), ("  calibrating redundant arms", "dim"))], id="banner"
        )
        yield _Fixed([(), line(" Connect: loading ...")], id="middle")
        yield _Fixed([line((" q", "key"), " Quit")], id="footer")

"""What is on the screen before everything is loaded: at once, and in the place of what comes. Light."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.screen import Screen

from operator_app.report.spans import Line, line
from operator_app.tui.lines import Lines


class _Fixed(Lines, can_focus=False):
    """Lines that never change."""

    FIXED = True

    def __init__(self, rows: list[Line], *, id: str) -> None:  # noqa: A002 - Textual's name
        super().__init__(id=id)
        self._rows = rows

    def on_mount(self) -> None:
        """Show them."""
        self.show_lines(self._rows)


class StartScreen(Screen[None]):
    """Strip, a word, and how to leave."""

    AUTO_FOCUS = ""

    def compose(self) -> ComposeResult:
        """In the places that the main screen has for them."""
        yield _Fixed(
            [line((" STOP ", "badge"), (" SPACE/F8", "key"), ("  no arm yet", "dim"))], id="strip"
        )
        yield _Fixed(
            [line((" sarcal ", "badge"), ("  calibrating redundant arms", "dim"))], id="banner"
        )
        yield _Fixed([(), line(" Connect: loading ...")], id="middle")
        yield _Fixed([line((" q", "key"), " Quit")], id="footer")

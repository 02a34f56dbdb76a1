"""What was said: the alarm that stands, the last messages, and all of them to read. Knows one snapshot."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from textual import events

from operator_app.report.spans import Line, clip, cut, wrapped
from operator_app.session.ui.guards import ends_with_any_key
from operator_app.session.ui.snapshot import Level, Message, SessionSnapshot
from operator_app.session.ui.user_interface import ShownAlarm
from operator_app.tui.lines import Clicked, Lines

ROWS = 4
"""Rows of the log while an alarm stands, at least."""
SHOWS_ALL = " … ({key} shows all of it)"
MARKS = {Level.INFO: ("", "dim"), Level.WARNING: ("▲ ", "warn"), Level.ALARM: ("■ ", "alarm")}


class Log(Lines, can_focus=False):
    """The newest alarm that stands, in all its words; then the last messages, newest first.

    Of messages the newest is shown in any case, older ones where they fit.

    Attributes
    ----------
    alarm
        The one on the screen.
    """

    alarm: ShownAlarm | None = None

    def rows_for(self, s: SessionSnapshot, width: int, most: int) -> int:
        """Rows that an alarm needs: `ROWS` to `most`."""
        return min(max(len(_alarm_rows(s, width)), ROWS), most)

    def build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        """As many lines as there are rows; what has no room says which key shows all of it."""
        standing = {alarm.number for alarm in s.alarms}
        rows = _alarm_rows(s, width)
        whole = len(rows) <= height
        rows = cut(rows, width, height, SHOWS_ALL.format(key="A"))
        self.alarm = ShownAlarm(number=s.alarms[-1].number, whole=whole) if rows else None
        # While any key ends the motion, none shows more.
        more = " …" if ends_with_any_key(s.task) else SHOWS_ALL.format(key="l")
        others = [m for m in s.messages[::-1] if m.number not in standing]
        for k, message in enumerate(others):
            said = _rows(message, width, message.text)
            left = height - len(rows)
            if len(said) > left and k:
                break
            rows += cut(said, width, left, more)
        return [clip(row, width) for row in rows]

    def on_click(self, event: events.Click) -> None:
        """A click shows all that was said; it ends no motion."""
        self.post_message(Clicked("messages"))


def _alarm_rows(s: SessionSnapshot, width: int) -> list[Line]:
    """The newest alarm; how many others wait behind it."""
    if not s.alarms:
        return []
    count = len(s.alarms)
    which = f"1 of {count}: " if count > 1 else ""
    return _rows(s.alarms[-1], width, f"{which}{s.alarms[-1].text} (A acknowledges)")


def _rows(message: Message, width: int, text: str) -> list[Line]:
    glyph, role = MARKS[message.level]
    pieces = wrapped(f" {message.time} {glyph}{text}", width - 1, role, " " * 10)
    return [((" ", "text"), *piece) for piece in pieces]


def messages_text(s: SessionSnapshot, width: int) -> str:
    """Return all that was said, newest first, each message whole."""
    return (
        "\n".join(
            textwrap.fill(
                f"{message.time} {MARKS[message.level][0]}{message.text}",
                width,
                subsequent_indent=" " * 9,
            )
            for message in s.messages[::-1]
        )
        or "nothing was said yet"
    )

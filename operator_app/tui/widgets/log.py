"""The log: the standing alarm, the last messages, and all messages to read."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from textual import events

from operator_app.report.spans import Line, clip, cut, wrapped
from operator_app.session.ui.guards import stops_on_any_key
from operator_app.session.ui.snapshot import Level, Message, SessionSnapshot
from operator_app.session.ui.user_interface import ShownAlarm
from operator_app.tui.lines import Clicked, Lines

ROWS = 4
"""Least rows of the log while an alarm stands."""
SHOWS_ALL = " … ({key} shows all of it)"
MARKS = {Level.INFO: ("", "dim"), Level.WARNING: ("▲ ", "warn"), Level.ALARM: ("■ ", "alarm")}


class Log(Lines, can_focus=False):
    """The newest standing alarm in full, then the last messages, newest first.

    The newest message is always shown, older ones where they fit.

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
        """Return as many lines as there are rows; where one is cut, the key that shows it in full."""
        standing = {alarm.number for alarm in s.alarms}
        rows = _alarm_rows(s, width)
        whole = len(rows) <= height
        rows = cut(rows, width, height, SHOWS_ALL.format(key="A"))
        self.alarm = ShownAlarm(number=s.alarms[-1].number, whole=whole) if rows else None
        # During a motion every key ends it: none is offered.
        more = " …" if stops_on_any_key(s.task) else SHOWS_ALL.format(key="l")
        others = [m for m in s.messages[::-1] if m.number not in standing]
        for k, message in enumerate(others):
            said = _rows(message, width, message.text)
            left = height - len(rows)
            if len(said) > left and k:
                break
            rows += cut(said, width, left, more)
        return [clip(row, width) for row in rows]

    def on_click(self, event: events.Click) -> None:
        """Show all messages; the click ends no motion."""
        self.post_message(Clicked("messages"))


def _alarm_rows(s: SessionSnapshot, width: int) -> list[Line]:
    """Return the lines of the newest alarm, and how many others wait."""
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
    """Return all messages in full, newest first."""
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

"""Status panels of all steps: safety strip, banner and log of messages. Dialogs do not cover the strip."""

import textwrap
from collections.abc import Sequence

from hardware.arm import DriveState, JointMode
from operator_app.messages.errors import unstopped_words
from operator_app.report.spans import Line, Span, clip, cut, length, wrapped
from operator_app.session.ui.guards import stops_on_any_key
from operator_app.session.ui.snapshot import DataState, Level, Message, SessionSnapshot
from operator_app.session.ui.user_interface import ShownAlarm
from operator_app.tui.lines import Lines
from operator_app.units import DATA_AGE

HEARTBEAT_LATE_S = 0.35


class SafetyStrip(Lines, can_focus=False):
    """One row with all that a person must know before approaching the arm: STOP, bus, data, modes and drives."""

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        short = width < 110
        keys = " SPC/F8" if short else " SPACE/F8"
        stop: list[Span] = [(" STOP ", "badge @stop"), (keys, "key @stop")]
        parts = (_arm, _bus, _heartbeat, _data, _modes, _drives)
        cells = [stop, *(part(s, short=short) for part in parts)]
        row = _joined(cells, short=short)
        if length(row) > width and not short:
            # Leave out the number of free joints.
            cells[-2] = _modes(s, short=True)
            row = _joined(cells, short=short)
        if length(row) > width:
            # Omit the modes, which the step's view shows too; the state of the drives is shown only in the strip.
            row = _joined([*cells[:-2], cells[-1]], short=short)
        return [clip(row, width)]


def _joined(cells: Sequence[Sequence[Span]], *, short: bool) -> Line:
    separator = ("│" if short else " │ ", "dim")
    first, *others = cells
    return (*first, *(span for cell in others for span in (separator, *cell)))


class Banner(Lines, can_focus=False):
    """The line below the safety strip: whether the arm is real, and the most urgent of STOP, lost data, task, hint."""

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        kind: Span = (" SIMULATED " if s.simulated else " REAL ARM ", "badge")
        return [clip((kind, (" ", "text"), *_status(s)), width)]


def _status(s: SessionSnapshot) -> Line:
    if s.unstopped_joints:
        return ((f"■ {unstopped_words(s.unstopped_joints)}: use the hardware stop", "alarm"),)
    if s.stopped_for:
        return ((f"■ STOPPED BY ITSELF {s.stopped_for}", "alarm"),)
    explained = s.stop is not None and (s.stopped or s.stop.problem)
    if explained or (s.stopped and s.data is not DataState.LOST):
        return ((f"■ SOFTWARE STOP {_stop_words(s)}", "alarm"),)
    if s.data is DataState.LOST:
        return (("▲ DATA LOST quick stop sent; state unknown: look before you go near", "alarm"),)
    if s.task is not None and stops_on_any_key(s.task):
        key = "" if s.task.ending else "ANY KEY STOPS  "
        return ((f"▶ {key}{s.task.progress}", "accent"),)
    if s.task is not None:
        return (("◌ ", "bold"), (s.task.progress, "text"))
    if s.simulated:
        return (("no real arm on this bus: nothing can be damaged", "dim"),)
    return (("hardware stop within reach? Software STOP is not an emergency stop", "dim"),)


def _stop_words(s: SessionSnapshot) -> str:
    report = s.stop
    if report is None:
        return "latched; R resets it"
    if report.problem:
        return f"could NOT be sent: use the hardware stop ({report.problem})"
    joints = len(s.arm.joints) if s.arm is not None else 0
    ago = s.now_s - report.asked_s
    if report.acknowledged_after_s is None:
        return f"sent {ago:.1f} s ago, {report.drives_stopped} of {joints} drives stopped"
    took = DATA_AGE(report.acknowledged_after_s).with_unit
    return f"all {joints} drives stopped within {took}; R resets it"


def _arm(s: SessionSnapshot, *, short: bool) -> list[Span]:
    kind = ("SIM" if short else "SIMULATED") if s.simulated else "REAL"
    serial = s.identity.serial_number if s.identity is not None else ""
    return [(kind, "bold"), *([(f" {serial}", "text")] if serial else [])]


def _bus(s: SessionSnapshot, *, short: bool) -> list[Span]:
    if not s.connected:
        return [("BUS ", "dim"), ("○" if short else "○ not connected", "dim")]
    if s.arm is None or s.data is DataState.LOST:
        return [("BUS ", "dim"), ("▲ SILENT", "alarm")]
    if s.data is DataState.STALE:
        return [("BUS ", "dim"), ("▲" if short else "▲ LATE", "warn")]
    rate = "" if short else f" {s.sync_rate_hz:3.0f}/s"
    return [("BUS ", "dim"), ("● ok", "text"), (rate, "text")]


def _heartbeat(s: SessionSnapshot, *, short: bool) -> list[Span]:
    ages = s.arm.heartbeat_age_s if s.arm is not None else {}
    if not ages:
        return [("HB ", "dim"), ("○", "dim")]
    oldest = max(ages.values())
    if oldest > HEARTBEAT_LATE_S:
        node = max(ages, key=lambda n: ages[n])
        return [("HB ", "dim"), (f"▲ {'N' if short else 'NODE '}{node} LATE", "warn")]
    return [("HB ", "dim"), ("●" if short else f"● {DATA_AGE(oldest).with_unit:>6}", "text")]


def _data(s: SessionSnapshot, *, short: bool) -> list[Span]:
    stale = f"▲ J{s.stale_joints[0]} STALE" if len(s.stale_joints) == 1 else "▲ STALE"
    shown: dict[DataState, Span] = {
        DataState.NONE: ("○", "dim"),
        DataState.FRESH: ("●" if short else f"● {DATA_AGE(s.oldest_s).with_unit:>6}", "text"),
        DataState.STALE: (stale, "warn"),
        DataState.LOST: ("▲ LOST", "alarm"),
    }
    return [("DATA ", "dim"), shown[s.data]]


def _modes(s: SessionSnapshot, *, short: bool) -> list[Span]:
    joints = () if s.arm is None else s.arm.joints
    position = [str(j.joint) for j in joints if j.mode is JointMode.POSITION]
    free = sum(j.mode is JointMode.FREE for j in joints)
    if not position and not free:
        return [("MODE ", "dim"), ("○", "dim")]
    if not free:
        return [("POS all", "text")]
    names = " ".join(f"J{j}" for j in position) or "none"
    spans: list[Span] = [("POS ", "dim"), (names, "accent")]
    return spans if short else [*spans, (f" · FREE {free}", "text")]


def _drives(s: SessionSnapshot, *, short: bool) -> list[Span]:
    word = "DRV " if short else "DRIVES "
    if s.arm is None:
        return [(word, "dim"), ("○", "dim")]
    if faults := tuple(s.drive_faults):
        which = f"J{faults[0]}" if len(faults) == 1 else str(len(faults))
        return [(word, "dim"), (f"■ {which} FAULT", "alarm")]
    if s.stopped:
        return [(word, "dim"), ("■ STOP", "alarm")]
    count = len(s.arm.joints)
    on = sum(j.drive is DriveState.OPERATION_ENABLED for j in s.arm.joints)
    return [(word, "dim"), ("on" if on == count else f"{on}/{count} on", "text")]


LOG_ROWS = 4
"""Fewest rows of the log while there is an alarm."""
SHOWS_ALL = " … ({key} shows all of it)"
MARKS = {Level.INFO: ("", "dim"), Level.WARNING: ("▲ ", "warn"), Level.ALARM: ("■ ", "alarm")}


class Log(Lines, can_focus=False):
    """The newest alarm, then the newest message, then older messages as far as they fit."""

    alarm: ShownAlarm | None = None

    def rows_for(self, s: SessionSnapshot, width: int, most: int) -> int:
        """Return the number of rows that the newest alarm needs, at least `LOG_ROWS`, at most `most`."""
        return min(max(len(_alarm_rows(s, width)), LOG_ROWS), most)

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        standing = {alarm.number for alarm in s.alarms}
        rows = _alarm_rows(s, width)
        all_visible = len(rows) <= height
        rows = cut(rows, width, height, SHOWS_ALL.format(key="A"))
        self.alarm = (
            ShownAlarm(number=s.alarms[-1].number, all_visible=all_visible) if rows else None
        )
        # During a motion, every key ends the motion: offer no key.
        more = " …" if stops_on_any_key(s.task) else SHOWS_ALL.format(key="l")
        others = [m for m in s.messages[::-1] if m.number not in standing]
        for k, message in enumerate(others):
            message_rows = _rows(message, width, message.text)
            free_rows = height - len(rows)
            if len(message_rows) > free_rows and k:
                break
            rows += cut(message_rows, width, free_rows, more)
        # Unlike a key, a click does not end a motion. It may be anywhere in the row.
        full = ((*clip(row, width), (" " * (width - length(row)), "text")) for row in rows)
        return [tuple((text, f"{role} @messages") for text, role in row) for row in full]


def _alarm_rows(s: SessionSnapshot, width: int) -> list[Line]:
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
    texts = (f"{m.time} {MARKS[m.level][0]}{m.text}" for m in s.messages[::-1])
    rows = [textwrap.fill(text, width, subsequent_indent=" " * 9) for text in texts]
    return "\n".join(rows) or "no messages yet"

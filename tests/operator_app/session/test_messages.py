"""An alarm stands until it is resolved or acknowledged; no message takes it out of sight."""

from __future__ import annotations

from operator_app.session.messages import MESSAGES_KEPT, acknowledged, resolved_by, told
from operator_app.session.snapshot import Level, SessionSnapshot, TaskKind
from oracles.story import story


def say(s: SessionSnapshot, level: Level, text: str, *until: TaskKind) -> SessionSnapshot:
    return told(s, level, text, time="12:00:00", until=frozenset(until))


def texts(s: SessionSnapshot) -> list[str]:
    return [alarm.text for alarm in s.alarms]


def test_an_alarm_outlives_every_other_message() -> None:
    s = say(story()["start"], Level.ALARM, "hot")
    for k in range(2 * MESSAGES_KEPT):
        s = say(s, Level.WARNING if k % 2 else Level.INFO, f"{k}")
    assert len(s.messages) == MESSAGES_KEPT
    assert texts(s) == ["hot"]


def test_it_is_said_again_only_when_it_stands_no_more() -> None:
    s = say(say(story()["start"], Level.ALARM, "hot"), Level.ALARM, "hot")
    assert texts(s) == ["hot"]
    again = say(acknowledged(s, s.alarms[0].number), Level.ALARM, "hot")
    assert texts(again) == ["hot"]
    assert again.alarms[0].number > s.alarms[0].number


def test_only_the_work_that_it_waits_for_resolves_it() -> None:
    s = say(story()["start"], Level.ALARM, "hot", TaskKind.RESET, TaskKind.CONNECT)
    s = say(s, Level.ALARM, "full", TaskKind.EXPORT)
    s = say(s, Level.ALARM, "unread")
    assert texts(resolved_by(s, TaskKind.CAPTURE)) == ["hot", "full", "unread"]
    assert texts(resolved_by(s, TaskKind.RESET)) == ["full", "unread"]
    assert texts(resolved_by(s, TaskKind.EXPORT)) == ["hot", "unread"]


def test_one_is_acknowledged_and_no_other() -> None:
    s = story()["start"]
    for text in ("hot", "full", "unread"):
        s = say(s, Level.ALARM, text)
    seen = acknowledged(s, s.alarms[1].number)
    assert texts(seen) == ["hot", "unread"]
    assert seen.messages == s.messages
    # Nobody has seen what is not there.
    assert acknowledged(seen, s.alarms[1].number) == seen

"""An alarm is shown until it is resolved or acknowledged, whatever other messages follow."""

import pytest

from hardware.errors import (
    BusError,
    ControlDenied,
    DriveDiverged,
    DriveFault,
    DuplicateNodeId,
    NodeRestarted,
    OtherMaster,
    SensorFault,
)
from operator_app.errors import ConnectAgainError, GuardError
from operator_app.session.ui.snapshot import (
    MAX_MESSAGES,
    Level,
    SessionSnapshot,
    TaskKind,
    resolving_tasks,
)
from tests.oracles.story import story


def say(s: SessionSnapshot, level: Level, text: str, *resolving_tasks: TaskKind) -> SessionSnapshot:
    return s.with_message(level, text, time="12:00:00", resolving_tasks=frozenset(resolving_tasks))


def texts(s: SessionSnapshot) -> list[str]:
    return [alarm.text for alarm in s.alarms]


def test_an_alarm_is_kept_longer_than_other_messages():
    s = say(story()["start"], Level.ALARM, "hot")
    for k in range(2 * MAX_MESSAGES):
        s = say(s, Level.WARNING if k % 2 else Level.INFO, f"{k}")
    assert len(s.messages) == MAX_MESSAGES
    assert texts(s) == ["hot"]


def test_a_repeated_message_becomes_the_newest_and_is_shown_again():
    s = say(say(story()["start"], Level.ALARM, "hot"), Level.ALARM, "full")
    again = s.with_message(Level.ALARM, "hot", time="12:00:01")
    assert texts(again) == [m.text for m in again.messages] == ["full", "hot"]
    assert again.alarms[-1].time == "12:00:01"
    assert again.alarms[-1].number > s.messages[-1].number
    acknowledged = again.without_alarm(again.alarms[-1].number)
    assert texts(acknowledged) == ["full"]
    assert acknowledged.messages == again.messages
    assert acknowledged.without_alarm(again.alarms[-1].number) == acknowledged
    later = say(acknowledged, Level.ALARM, "hot")
    assert texts(later) == ["full", "hot"]
    assert later.alarms[-1].number > again.alarms[-1].number


@pytest.mark.parametrize(
    ("error", "asks"),
    [
        (SensorFault(3, "jumped", since_sync=7), True),
        (SensorFault(3, "stands still", stuck=True), False),
        (DriveDiverged(3, 700, 7), False),
        (NodeRestarted((5,), ["joint 5"]), True),
        (DuplicateNodeId((5,)), True),
        (OtherMaster("somebody else"), True),
        (ControlDenied(126), True),
        (BusError("silent"), False),
        (DriveFault(3, 0x8311, "torque"), False),
        (GuardError("not yet", "do it"), False),
        (ConnectAgainError("at zero", "home it"), True),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else str(value),
)
def test_a_persisting_refusal_asks_to_reconnect(error, asks):
    for kind in (TaskKind.RESET, TaskKind.CAPTURE):
        s = say(story()["start"], Level.ALARM, "told", *resolving_tasks(error, kind))
        assert s.needs_reconnect is asks
    assert texts(s.without_resolved(TaskKind.CAPTURE)) == []


def test_only_the_awaited_task_resolves_an_alarm():
    s = say(story()["start"], Level.ALARM, "hot", TaskKind.RESET, TaskKind.CONNECT)
    s = say(say(s, Level.ALARM, "full", TaskKind.EXPORT), Level.ALARM, "unread")
    assert texts(s.without_resolved(TaskKind.CAPTURE)) == ["hot", "full", "unread"]
    assert texts(s.without_resolved(TaskKind.RESET)) == ["full", "unread"]
    assert texts(s.without_resolved(TaskKind.EXPORT)) == ["hot", "unread"]

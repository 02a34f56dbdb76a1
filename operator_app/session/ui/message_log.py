"""What the operator was told, line by line, and which alarms stand. Pure: knows no thread and no screen.

An alarm stands until the work that it hinders has been done, or the operator acknowledges it: no message
that comes later takes it out of sight.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from hardware.errors import (
    ControlDenied,
    DriveDiverged,
    DuplicateNodeId,
    HardwareError,
    MappingChanged,
    NodeRestarted,
    OtherMaster,
    SensorFault,
)
from operator_app.errors import ConnectAgainError
from operator_app.session.ui.snapshot import Level, Message, SessionSnapshot, TaskKind

MESSAGES_KEPT: Final = 100

ARM_AGAIN: Final = frozenset({TaskKind.RESET, TaskKind.CONNECT})
"""What resolves an alarm about the arm."""


CONNECT_AGAIN: Final = (
    ConnectAgainError,
    ControlDenied,
    OtherMaster,
    MappingChanged,
    NodeRestarted,
    DuplicateNodeId,
)
"""What the arm goes on refusing for until it is connected again."""


def until(error: Exception, kind: TaskKind) -> frozenset[TaskKind]:
    """Return the work that resolves the alarm about an error of such work."""
    # A reading that jumped stays in doubt; of a sensor that stands still only the poses are that read so.
    jumped = isinstance(error, SensorFault) and not (
        isinstance(error, DriveDiverged) or error.stuck
    )
    if jumped or isinstance(error, CONNECT_AGAIN):
        return frozenset({TaskKind.CONNECT, kind})
    return (ARM_AGAIN if isinstance(error, HardwareError) else frozenset()) | {kind}


def asks_to_connect_again(s: SessionSnapshot) -> bool:
    """Whether an alarm stands that only connecting again resolves."""
    return any(
        TaskKind.CONNECT in alarm.until and TaskKind.RESET not in alarm.until for alarm in s.alarms
    )


def told(
    s: SessionSnapshot,
    level: Level,
    text: str,
    *,
    time: str,
    until: frozenset[TaskKind] = frozenset(),
) -> SessionSnapshot:
    """Add a message; an alarm that stands already is not said twice, but is the newest then.

    `until` is the work that resolves an alarm when it is done; without any, only the operator does.
    """
    number = s.messages[-1].number + 1 if s.messages else 1
    message = Message(number=number, time=time, level=level, text=text, until=until)
    if level is not Level.ALARM:
        return replace(s, messages=(*s.messages, message)[-MESSAGES_KEPT:])
    said = {standing.number for standing in s.alarms if standing.text == text}
    messages, alarms = (
        (*(m for m in before if m.number not in said), message)[-MESSAGES_KEPT:]
        for before in (s.messages, s.alarms)
    )
    return replace(s, messages=messages, alarms=alarms)


def resolved_by(s: SessionSnapshot, kind: TaskKind) -> SessionSnapshot:
    """Let go of the alarms that such work resolves, now that it is done."""
    standing = tuple(alarm for alarm in s.alarms if kind not in alarm.until)
    return s if len(standing) == len(s.alarms) else replace(s, alarms=standing)


def acknowledged(s: SessionSnapshot, number: int) -> SessionSnapshot:
    """Let go of the alarm of this number: the operator has seen it; what it is about stays as it is."""
    return replace(s, alarms=tuple(alarm for alarm in s.alarms if alarm.number != number))

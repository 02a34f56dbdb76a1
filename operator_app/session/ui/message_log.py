"""Pure functions on the messages and alarms of a snapshot.

An alarm stays until a task that resolves it has succeeded, or until the operator acknowledges it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from hardware import errors
from operator_app.errors import ConnectAgainError
from operator_app.session.ui.snapshot import Level, Message, SessionSnapshot, TaskKind

MAX_MESSAGES: Final = 100

ARM_RECOVERY: Final = frozenset({TaskKind.RESET, TaskKind.CONNECT})
"""Tasks that resolve an alarm about the arm."""


CONNECT_AGAIN: Final = (
    ConnectAgainError,
    errors.ControlDenied,
    errors.OtherMaster,
    errors.MappingChanged,
    errors.NodeRestarted,
    errors.DuplicateNodeId,
)
"""Errors that persist until the arm is connected again."""


def resolving_tasks(error: Exception, kind: TaskKind) -> frozenset[TaskKind]:
    """Return the kinds of task whose success resolves the alarm about `error`, which a task of `kind` raised."""
    # After a jump, all later readings are doubtful; with a stuck sensor, only readings of the excluded poses are.
    jumped = isinstance(error, errors.SensorFault) and not (
        isinstance(error, errors.DriveDiverged) or error.stuck
    )
    if jumped or isinstance(error, CONNECT_AGAIN):
        return frozenset({TaskKind.CONNECT, kind})
    return (ARM_RECOVERY if isinstance(error, errors.HardwareError) else frozenset()) | {kind}


def needs_reconnect(s: SessionSnapshot) -> bool:
    """Whether there is an alarm that only a new connection resolves."""
    return any(
        TaskKind.CONNECT in alarm.resolving_tasks and TaskKind.RESET not in alarm.resolving_tasks
        for alarm in s.alarms
    )


def add_message(
    s: SessionSnapshot,
    level: Level,
    text: str,
    *,
    time: str,
    resolving_tasks: frozenset[TaskKind] = frozenset(),
) -> SessionSnapshot:
    """Add a message; an alarm replaces an existing alarm with the same text.

    An alarm is resolved when one of its `resolving_tasks` succeeds; without such tasks it stays until acknowledged.
    """
    number = s.messages[-1].number + 1 if s.messages else 1
    message = Message(
        number=number, time=time, level=level, text=text, resolving_tasks=resolving_tasks
    )
    if level is not Level.ALARM:
        return replace(s, messages=(*s.messages, message)[-MAX_MESSAGES:])
    repeated = {standing.number for standing in s.alarms if standing.text == text}
    messages, alarms = (
        (*(m for m in before if m.number not in repeated), message)[-MAX_MESSAGES:]
        for before in (s.messages, s.alarms)
    )
    return replace(s, messages=messages, alarms=alarms)


def without_resolved(s: SessionSnapshot, kind: TaskKind) -> SessionSnapshot:
    """Remove the alarms that a task of this kind resolves."""
    standing = tuple(alarm for alarm in s.alarms if kind not in alarm.resolving_tasks)
    return s if len(standing) == len(s.alarms) else replace(s, alarms=standing)


def without_acknowledged(s: SessionSnapshot, number: int) -> SessionSnapshot:
    """Remove the alarm with this number; its cause may persist."""
    return replace(s, alarms=tuple(alarm for alarm in s.alarms if alarm.number != number))

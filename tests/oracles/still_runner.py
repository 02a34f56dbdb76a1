"""A runner with a constant snapshot that records its tasks: for tests of keys and screens."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from operator_app.session.store.folders import SessionEntry
from operator_app.session.ui.snapshot import Change, Level, Message, SessionSnapshot, TaskKind


class StaticRunner:
    """See the module. `asked` are the tasks (kind, text); `stops` and `cancels` are counters."""

    def __init__(self, picture: SessionSnapshot) -> None:
        self.picture = picture
        self.defect: BaseException | None = None
        self.asked: list[tuple[TaskKind, str]] = []
        self.connecting = False
        self.stops = self.cancels = 0
        self.session = SimpleNamespace(
            journal=SimpleNamespace(path=picture.folder / "journal.jsonl"), state=picture.state
        )
        self.operations: Any = None

    @property
    def connected(self) -> bool:
        return self.picture.connected

    def snapshot(self) -> SessionSnapshot:
        return self.picture

    def submit(self, kind: TaskKind, text: str, work: Any) -> None:
        self.asked.append((kind, text))

    def publish(self, change: Change) -> None:
        self.picture = change(self.picture)

    def say(
        self, level: Level, text: str, resolving_tasks: frozenset[TaskKind] = frozenset()
    ) -> None:
        number = len(self.picture.messages) + 1
        message = Message(
            number=number, time="12:00:00", level=level, text=text, resolving_tasks=resolving_tasks
        )
        self.publish(lambda s: replace(s, messages=(*s.messages, message)))

    def acknowledge(self, number: int) -> None:
        self.publish(lambda s: s.without_alarm(number))

    def stop(self) -> None:
        self.stops += 1

    def cancel(self) -> None:
        self.cancels += 1


class StaticSource:
    """A source of one runner; `entries` are the existing sessions."""

    def __init__(self, picture: SessionSnapshot, entries: tuple[SessionEntry, ...] = ()) -> None:
        self.runner = StaticRunner(picture)
        self.entries = entries
        self.begun = 0
        self.requested_procedure: str | None = None
        self.resumed_references: list[str] = []

    def new(self, procedure: str | None = None) -> Any:
        self.begun += 1
        self.requested_procedure = procedure
        return self.runner

    def resumed(self, reference: str) -> Any:
        self.resumed_references.append(reference)
        return self.runner

    def sessions(self) -> tuple[SessionEntry, ...]:
        return self.entries

    def unfinished(self) -> SessionEntry | None:
        return self.entries[0] if self.entries else None

    def close(self, reason: str) -> None:
        """Do nothing."""


def entry(picture: SessionSnapshot, name: str = "20260131-110000-hinge") -> SessionEntry:
    """An earlier session in the snapshot's state."""
    return SessionEntry(folder=Path("sessions") / name, state=picture.state, torn="", problem="")

"""Events in the journal of a session, read from the disk."""

from typing import Any

from operator_app.session.store.journal import read_journal
from operator_app.session.store.journal_format import JournalEvent
from operator_app.session.workflow.session import Session


def journal_events(session: Session) -> tuple[JournalEvent, ...]:
    return read_journal(session.journal.path.parent).events


def event_data(session: Session, name: str) -> list[dict[str, Any]]:
    return [dict(event.data) for event in journal_events(session) if event.name == name]

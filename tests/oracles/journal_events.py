"""Events in the journal of a session, read from the disk."""

from pathlib import Path
from typing import Any

from operator_app.session.store.journal import read_journal
from operator_app.session.store.journal_format import JournalEvent
from operator_app.session.workflow.session import Session


def journal_events(session: Session | Path) -> tuple[JournalEvent, ...]:
    """Return all events of a session or of the session in a folder."""
    folder = session if isinstance(session, Path) else session.journal.path.parent
    return read_journal(folder).events


def event_data(session: Session | Path, name: str) -> list[dict[str, Any]]:
    """Return the data of the events with this name."""
    return [dict(event.data) for event in journal_events(session) if event.name == name]

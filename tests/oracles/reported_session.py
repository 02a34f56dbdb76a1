"""What `sarcal report` makes of a journal's events, and how a page writes a number."""

from collections.abc import Sequence
from typing import Any

from operator_app.report.subject import Subject, subject_of_session
from operator_app.session.store.journal import JournalEvent
from operator_app.session.store.replay import replay
from operator_app.session.store.stored_calibration import session_calibration, with_checks
from solver.errors import UnidentifiableError
from tests.oracles.short_procedure import short_procedure

HOSTILE = '<script>alert("1")</script></td></table>\u202e & \x07\ud800'


def subject_of(events: Sequence[JournalEvent], **options: Any) -> Subject:
    """As `sarcal report` reads a journal."""
    state = replay(events)
    try:
        found = session_calibration(state, short_procedure(16, "datasheet"), **options)
    except UnidentifiableError as error:
        return subject_of_session(
            "session", events, short_procedure(16, "datasheet"), None, unidentifiable=error
        )
    return subject_of_session(
        "session",
        events,
        short_procedure(16, "datasheet"),
        with_checks(found, state, short_procedure(16, "datasheet")),
    )


def number(words: str) -> float:
    return float(words.replace("\u2212", "-"))

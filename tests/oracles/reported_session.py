"""The report of a journal's events, and numbers of its pages."""

from collections.abc import Sequence
from typing import Any

from operator_app.report.subject import Subject, subject_of_session
from operator_app.session.store.journal import JournalEvent
from operator_app.session.store.replay import replay
from operator_app.session.store.stored_calibration import session_calibration, with_checks
from solver.errors import UnidentifiableError
from tests.oracles.short_procedure import short_procedure

HOSTILE = '<script>alert("1")</script></td></table>\u202e & \x07\ud800'


def report_subject(events: Sequence[JournalEvent], **options: Any) -> Subject:
    """Subject of the report of a journal, as in `sarcal report`."""
    state, procedure = replay(events), short_procedure(16, "datasheet")
    try:
        calibration = session_calibration(state, procedure, **options)
    except UnidentifiableError as error:
        return subject_of_session("session", events, procedure, None, unidentifiable=error)
    checked = with_checks(calibration, state, procedure)
    return subject_of_session("session", events, procedure, checked)


def number(words: str) -> float:
    return float(words.replace("\u2212", "-"))

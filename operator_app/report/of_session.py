"""The report page of the session that is open. Knows the journal and the report, no widget."""

from __future__ import annotations

from pathlib import Path

from operator_app.config.atomic import write_atomically
from operator_app.report.html import report_html
from operator_app.report.subject import subject_of_session
from operator_app.session.journal import read_journal
from operator_app.session.session import Session

REPORT_NAME = "report.html"


def write_report(session: Session, estimator: str, unsensed_joints: tuple[int, ...]) -> Path:
    """Write the page into the session's folder, from its journal."""
    folder = session.journal.path.parent
    contents = read_journal(folder)
    subject = subject_of_session(
        folder.resolve().name,
        contents.events,
        session.procedure,
        torn=contents.torn,
        estimator=estimator,
        unsensed_joints=unsensed_joints,
    )
    target = folder / REPORT_NAME
    write_atomically(target, report_html(subject))
    return target
